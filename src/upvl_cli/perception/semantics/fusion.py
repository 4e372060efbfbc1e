"""Scores of words fused over a drive: of what stands by its place, of what moves by its track.

A picture shows a point once, from one side, in one light. What stands is the same whenever it is seen: its scores are
averaged over the sweeps in which a camera saw its place, and a point that no camera sees, or that another thing hides,
takes those of its place. What moves has no place; the points of a tracked box are averaged over the track.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.semantics.config import FusionConfig
from upvl_cli.perception.voxels import VoxelSums
from upvl_cli.types import Bools, Boxes, Floats, Ints

NO_CLASS = -1
NO_TRACK = -1


@dataclass(frozen=True)
class SweepScores:
    """What the words say of the n points of one sweep.

    Attributes:
        xyz_world_m: (n, 3) points in world axes.
        is_seen: (n,) whether a camera sees the point.
        score: (s, k) score of each of k classes for the s seen points, in their order.
        is_moving: (n,) whether the point moves.
        track_id: (n,) track whose box holds the moving point; `NO_TRACK` for all others.
    """

    xyz_world_m: Floats
    is_seen: Bools
    score: Floats
    is_moving: Bools
    track_id: Ints


class FusedScores(NamedTuple):
    """The fused scores of n points.

    Attributes:
        score: (n, k) mean score of each class; zeros where no frame speaks.
        num_frames: (n,) frames that speak for the point; 0 where none does.
    """

    score: Floats
    num_frames: Ints

    def classify(self) -> tuple[Ints, Floats]:
        """Return (n,) int8 the class of the highest score, `NO_CLASS` where none, and (n,) its lead over the next."""
        every = np.arange(len(self.score))
        best = self.score.argmax(axis=1)
        rest = self.score.copy()
        rest[every, best] = -np.inf
        # With one class alone there is no other to lead over: the lead is 0.
        second = rest.max(axis=1) if rest.shape[1] > 1 else self.score[every, best]
        speaks = self.num_frames > 0
        margin = np.where(speaks, self.score[every, best] - second, 0).astype(np.float32)
        return np.where(speaks, best, NO_CLASS).astype(np.int8), margin


class SceneEvidence:
    """Scores of places and tracks, added up sweep by sweep: as large as the places, however often they are seen."""

    def __init__(self, classes: int, config: FusionConfig) -> None:
        """Start without any.

        Args:
            classes: Number k of classes.
            config: Size of a place.
        """
        self._places = VoxelSums(config.voxel_m, classes)
        self._tracks: dict[int, Floats] = {}
        self._classes, self._config = classes, config

    def add(self, sweep: SweepScores) -> None:
        """Add the seen points of a sweep: those that stand to their places, those of a track to the track."""
        seen = np.flatnonzero(sweep.is_seen)
        stands = ~sweep.is_moving[seen]
        self._places.add(sweep.xyz_world_m[seen[stands]], sweep.score[stands])
        track_id = sweep.track_id[seen]
        for number in np.unique(track_id[track_id != NO_TRACK]).tolist():
            sums = self._tracks.setdefault(number, np.zeros(2 + self._classes))
            score = sweep.score[track_id == number]
            sums += [1, len(score), *score.sum(axis=0, dtype=np.float64)]

    def fit(self) -> FusedScene:
        """Return the means of all that was added."""
        places = self._places.totals()
        track_id = np.array(sorted(self._tracks), dtype=np.int64)
        tracks = np.array([self._tracks[number] for number in track_id.tolist()]).reshape(
            -1, 2 + self._classes
        )
        return FusedScene(
            cKDTree(places.centroid_m),
            FusedScores(_mean(places.values, places.weight), places.sweeps.astype(np.int64)),
            track_id,
            FusedScores(_mean(tracks[:, 2:], tracks[:, 1]), tracks[:, 0].astype(np.int64)),
            self._config,
        )


def _mean(sums: Floats, weight: Floats) -> Floats:
    return np.asarray(sums / np.maximum(weight, 1)[:, None], dtype=np.float32)


@dataclass(frozen=True)
class FusedScene:
    """The mean scores of p places and t tracks.

    Attributes:
        tree: The places, in world axes.
        places: Their scores.
        track_id: (t,) ascending numbers of the tracks.
        tracks: Their scores.
        config: How far a place reaches.
    """

    tree: cKDTree
    places: FusedScores
    track_id: Ints
    tracks: FusedScores
    config: FusionConfig

    def fuse(self, sweep: SweepScores) -> FusedScores:
        """Return the scores of all points of a sweep.

        A point that stands has those of its place, seen or not; one that moves those of its track; a seen one without
        either keeps those of its own pixel, and no frame speaks for the others.
        """
        total, classes = len(sweep.is_seen), sweep.score.shape[1]
        score, num_frames = np.zeros((total, classes), np.float32), np.zeros(total, np.int64)
        score[sweep.is_seen], num_frames[sweep.is_seen] = sweep.score, 1
        stands = np.flatnonzero(~sweep.is_moving)
        if self.tree.n and len(stands):
            distance, place = self.tree.query(
                sweep.xyz_world_m[stands], distance_upper_bound=self.config.radius_m
            )
            near = np.isfinite(distance)
            score[stands[near]] = self.places.score[place[near]]
            num_frames[stands[near]] = self.places.num_frames[place[near]]
        if len(self.track_id):
            place = np.minimum(np.searchsorted(self.track_id, sweep.track_id), len(self.track_id) - 1)
            known = self.track_id[place] == sweep.track_id
            score[known] = self.tracks.score[place[known]]
            num_frames[known] = self.tracks.num_frames[place[known]]
        return FusedScores(score, num_frames)


def class_scores(cosines: Floats, class_of_word: Ints) -> Floats:
    """Return (n, k) the cosine of each feature with the nearest word of each class.

    Args:
        cosines: (n, t) of n features with t words.
        class_of_word: (t,) class of each word, ascending from 0, without gaps.
    """
    first = np.flatnonzero(np.diff(class_of_word, prepend=-1))
    return (
        np.maximum.reduceat(cosines, first, axis=1) if len(cosines) else np.zeros((0, len(first)), np.float32)
    )


def tracks_of_points(
    xyz_m: Floats, is_moving: Bools, boxes: Boxes, track_id: Ints, *, margin_m: float
) -> Ints:
    """Return (n,) the track whose box holds each moving point, `NO_TRACK` for the others.

    A point in several boxes belongs to the first of them.

    Args:
        xyz_m: (n, 3) points, in the axes of the boxes.
        is_moving: (n,) whether each moves.
        boxes: b boxes.
        track_id: (b,) their tracks.
        margin_m: By how much a box grows on each side.
    """
    tracks = np.full(len(xyz_m), NO_TRACK, dtype=np.int64)
    moving = np.flatnonzero(is_moving)
    box, point = pairs_inside(xyz_m[moving], boxes, margin_m=margin_m)
    order = np.argsort(-box, kind="stable")  # of several boxes the first is written last
    tracks[moving[point[order]]] = track_id[box[order]]
    return tracks
