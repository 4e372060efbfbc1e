"""Looks at a whole track: which pictures show an object best, and one feature of all of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.labels.config import LookChoiceConfig
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, array


@dataclass(frozen=True)
class LookCandidates(ParallelArrays):
    """Objects in pictures: one item for each box and each camera that sees points of it.

    Attributes:
        step: (n,) number of the frame in the drive, from 0.
        time_s: (n,) time of the frame.
        camera: (n,) number of the camera.
        box: (n,) row of the box in its frame.
        track_id: (n,) number of the track.
        size_px: (n,) longer side of the object in the picture.
        area_px: (n,) area of its rectangle in the picture, as far as it lies inside.
        seen_share: (n,) share of the points of the box that this camera sees unoccluded, 0 to 1.
    """

    step: Array = array("int64")
    time_s: Array = array("float64")
    camera: Array = array("int64")
    box: Array = array("int64")
    track_id: Array = array("int64")
    size_px: Array = array("float64")
    area_px: Array = array("float64")
    seen_share: Array = array("float64")

    @property
    def quality(self) -> Floats:
        """(n,) area times share: a look is better the larger and the less occluded the object is."""
        return np.asarray(self.area_px * self.seen_share)


def choose_looks(candidates: LookCandidates, config: LookChoiceConfig) -> Ints:
    """Return the best candidates of each track, ascending.

    The best one is taken first, and any other only where it is not nearly the same picture: at least a time apart from
    all taken ones of its camera. Of equals the earlier item wins.

    Args:
        candidates: n of them.
        config: How many, how far apart, how large.
    """
    large = np.flatnonzero(candidates.size_px >= config.min_px)
    order = large[np.lexsort((large, -candidates.quality[large], candidates.track_id[large]))]
    chosen: list[int] = []
    taken: list[int] = []  # of the present track
    for index in order.tolist():
        if taken and candidates.track_id[taken[0]] != candidates.track_id[index]:
            chosen, taken = chosen + taken, []
        same = [each for each in taken if candidates.camera[each] == candidates.camera[index]]
        gap_s = np.abs(candidates.time_s[same] - candidates.time_s[index])
        if len(taken) < config.looks_per_track and (gap_s >= config.min_gap_s).all():
            taken.append(index)
    return np.sort(np.array(chosen + taken, dtype=np.int64))


def sharpness(rgb: Array) -> float:
    """Return the variance of the Laplacian of a picture over its variance; 0 for one without contrast.

    A blurred picture has less of the fine differences that the Laplacian answers to (Pech-Pacheco et al., ICPR 2000).

    Args:
        rgb: (h, w, 3) picture, 3 x 3 pixels or more.
    """
    gray = np.asarray(rgb, dtype=np.float64).mean(axis=2)
    inside = gray[1:-1, 1:-1]
    laplacian = gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:] - 4 * inside
    contrast = gray.var()
    return float(laplacian.var() / contrast) if inside.size and contrast > 0 else 0.0


@dataclass(frozen=True)
class TrackLooks:
    """What the looks at some tracks gave.

    Attributes:
        row_of_track: Row of each track that has a look.
        num_looks: (k,) looks at each.
        feature: (k, COMPONENTS) int8 their mean features, to be scaled by the steps of the basis.
    """

    row_of_track: dict[int, int]
    num_looks: Ints
    feature: Ints

    def of(self, track_id: Iterable[int]) -> tuple[Ints, Ints]:
        """Return (b,) looks at some tracks and their (b, COMPONENTS) features; zeros for those without any."""
        rows = [self.row_of_track.get(track, -1) for track in track_id]
        return (
            np.append(self.num_looks, 0)[rows].astype(np.int32),
            np.concatenate([self.feature, np.zeros((1, COMPONENTS), np.int8)])[rows],
        )


def pool_looks(track_id: Ints, vector: Floats, quality: Floats, sharp: Floats, basis: Basis) -> TrackLooks:
    """Return the mean feature of the looks at each track, each look weighted by how much it shows.

    The weight is the root of the quality. A look that is less sharp than the median of its track counts for less, in
    proportion: small pictures look sharper than large ones, so that a sharper one counts for no more.

    Args:
        track_id: (n,) the track of each look.
        vector: (n, d) their features, of length 1.
        quality: (n,) positive.
        sharp: (n,) their `sharpness`.
        basis: The space that the means are stored in.
    """
    tracks, row = np.unique(track_id, return_inverse=True)
    weight = np.sqrt(quality)
    for number in range(len(tracks)):
        own = row == number
        weight[own] *= np.minimum(sharp[own] / max(float(np.median(sharp[own])), 1e-9), 1.0)
    total = np.zeros((len(tracks), len(basis.mean)))
    np.add.at(total, row, vector * np.maximum(weight, 1e-9)[:, None])
    codes = basis.quantize(basis.project(total.astype(np.float32)))
    return TrackLooks(
        {int(track): number for number, track in enumerate(tracks)},
        np.bincount(row, minlength=len(tracks)),
        codes,
    )
