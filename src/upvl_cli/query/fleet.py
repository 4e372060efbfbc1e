"""The objects of a fleet, one a track: mean feature, size, speed, and the frame that shows it best."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.query.index import Objects, indexed_objects
from upvl_cli.query.store import Store
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, array, concat


@dataclass(frozen=True)
class FleetTracks(ParallelArrays):
    """Tracks with features of all drives; a box without a track is one of its own.

    Attributes:
        segment: (n,) name of the drive.
        track_id: (n,) number of the track, -1 for none.
        boxes: (n,) boxes that have a feature.
        frame: (n,) the frame in which most of its points have one.
        size_lwh_m: (n, 3) mean length, width and height.
        speed_mps: (n,) mean horizontal speed over the ground.
        confidence: (n,) mean score of the boxes.
        vector: (n, COMPONENTS + 1) mean feature over all points of all boxes, of length 1 (`Basis.compact`).
        spread: (n,) mean cosine distance of the features of its boxes from it; NaN with one box alone.
    """

    segment: Array = array("str")
    track_id: Array = array("int64")
    boxes: Array = array("int64")
    frame: Array = array("int64")
    size_lwh_m: Array = array("float32", 3)
    speed_mps: Array = array("float32")
    confidence: Array = array("float32")
    vector: Array = array("float32", COMPONENTS + 1)
    spread: Array = array("float32")


def fleet_tracks(store: Store, segments: Collection[str]) -> FleetTracks:
    """Return the tracks of the drives of a store; only the index is read.

    Args:
        store: The stored boxes.
        segments: Names of the drives; an empty collection takes all.
    """
    parts = []
    for segment, objects in indexed_objects(store):
        featured = objects[objects.num_features > 0]
        if len(featured) and (not segments or segment in segments):
            parts.append(_tracks(segment, featured, store.basis))
    return concat(parts, FleetTracks)


def _tracks(segment: str, objects: Objects, basis: Basis) -> FleetTracks:
    """Return the tracks of one drive, by ascending number; boxes without a track come first."""
    key = np.where(objects.track_id < 0, -1 - np.arange(len(objects)), objects.track_id)
    # The frame with the most points first within each track: it is the one that shows it best.
    order = np.lexsort((objects.frame, -objects.num_features, key))
    sorted_objects = objects[order]
    _, first, boxes = np.unique(key[order], return_index=True, return_counts=True)
    values = basis.dequantize(sorted_objects.pooled)
    points = sorted_objects.num_features.astype(np.float64)
    mean = _sums(values * points[:, None], first) / _sums(points[:, None], first)
    vector = basis.compact(mean)
    distance = 1 - np.einsum("nd,nd->n", basis.compact(values), np.repeat(vector, boxes, axis=0))
    spread = np.where(boxes > 1, _means(distance, first, boxes), np.nan)
    return FleetTracks(
        segment=np.full(len(first), segment),
        track_id=sorted_objects.track_id[first],
        boxes=boxes,
        frame=sorted_objects.frame[first],
        size_lwh_m=_sums(sorted_objects.size_lwh_m, first) / boxes[:, None],
        speed_mps=_means(sorted_objects.speed_mps, first, boxes),
        confidence=_means(sorted_objects.confidence, first, boxes),
        vector=vector,
        spread=spread,
    )


def _sums(values: Floats, first: Ints) -> Floats:
    return np.asarray(np.add.reduceat(values.astype(np.float64), first, axis=0))


def _means(values: Floats, first: Ints, count: Ints) -> Floats:
    return _sums(values[:, None], first)[:, 0] / count
