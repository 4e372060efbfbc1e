"""Counts of what was found: in all, by class and by drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.drawing.colours import CLASSES
from upvl_cli.report.drive_labels import DriveLabels, TrackTable
from upvl_cli.report.figures import Histogram, RankedClasses, histogram, kind_of, ranking
from upvl_cli.types import Array

MOST_CLASSES = 40
NO_WORD = "(no word)"  # of tracks that no camera saw


@dataclass(frozen=True)
class FoundTotals:
    """What was found in all drives of a report."""

    drives: int
    frames: int
    duration_s: float
    travel_m: float | None
    boxes: int
    moving_boxes: int
    tracks: int
    moving_tracks: int
    detections: int | None


@dataclass(frozen=True)
class ClassCounts:
    """What was found of one class; sizes are medians over tracks, the speed is that over moving boxes."""

    name: str
    kind: str
    boxes: int
    tracks: int
    moving_tracks: int
    size_lwh_m: tuple[float, float, float]
    speed_mps: float | None
    score: float

    @property
    def parked_tracks(self) -> int:
        """Tracks that move in no frame."""
        return self.tracks - self.moving_tracks


def class_counts(drives: Sequence[DriveLabels], tracks: TrackTable) -> Iterator[ClassCounts]:
    """Yield what was found of each class: the usual classes in their order, then others by their names."""
    box_class = np.concatenate([labels.class_name for labels in drives])
    is_moving = np.concatenate([labels.is_moving for labels in drives])
    speed_mps = np.concatenate([labels.speed_mps for labels in drives])
    for name in _ordered({str(name) for name in np.unique(tracks.class_name)}):
        mine, boxes = tracks.class_name == name, box_class == name
        moving = speed_mps[boxes & is_moving]
        length_m, width_m, height_m = np.median(tracks.size_lwh_m[mine], axis=0).tolist()
        yield ClassCounts(
            name=name,
            kind=kind_of(name),
            boxes=int(boxes.sum()),
            tracks=int(mine.sum()),
            moving_tracks=int(tracks.is_moving[mine].sum()),
            size_lwh_m=(length_m, width_m, height_m),
            speed_mps=float(np.median(moving)) if len(moving) else None,
            score=float(np.median(tracks.score[mine])),
        )


def travel_m(world_from_ego: Array) -> float:
    """Return the length of the way of the car.

    Args:
        world_from_ego: (T, 4, 4) its poses.
    """
    return float(np.linalg.norm(np.diff(world_from_ego[:, :3, 3], axis=0), axis=1).sum())


def distributions(
    drives: Sequence[DriveLabels], tracks: TrackTable
) -> tuple[list[RankedClasses], list[Histogram]]:
    """Return rankings of classes and words, and histograms; those without a value are left out."""
    kinds = [str(name) for name in tracks.class_name]
    words = [str(word) or NO_WORD for word in tracks.word]
    rankings = [ranking("Tracks by class", kinds, kinds), ranking("Tracks by word", words, kinds)]
    box = {
        name: np.concatenate([getattr(labels, name) for labels in drives])
        for name in ("class_name", "speed_mps", "range_m", "is_moving")
    }
    moving = box["is_moving"]
    histograms = [
        histogram(
            "Moving boxes by speed", "speed (m/s)", box["speed_mps"][moving], box["class_name"][moving]
        ),
        histogram(
            "Boxes by range", "horizontal distance from the car (m)", box["range_m"], box["class_name"]
        ),
        histogram("Tracks by length", "length of the box (m)", tracks.size_lwh_m[:, 0], kinds),
        histogram("Tracks by width", "width of the box (m)", tracks.size_lwh_m[:, 1], kinds),
        histogram("Tracks by height", "height of the box (m)", tracks.size_lwh_m[:, 2], kinds),
        histogram("Tracks by score", "score, 0 to 1", tracks.score, kinds),
        histogram("Tracks by duration", "time from the first box to the last (s)", tracks.duration_s, kinds),
    ]
    return [item for item in rankings if item], [item for item in histograms if item]


def class_changes(before: TrackTable, after: TrackTable) -> list[tuple[str, int, int]]:
    """Return for each class of two runs its tracks in the other run and in this one."""

    def counted(tracks: TrackTable) -> Mapping[str, int]:
        names, counts = np.unique(tracks.class_name, return_counts=True)
        return dict(zip(map(str, names), counts.tolist(), strict=True))

    old, new = counted(before), counted(after)
    return [(name, old.get(name, 0), new.get(name, 0)) for name in _ordered({*old, *new})]


def _ordered(names: set[str]) -> list[str]:
    return [*(name for name in CLASSES if name in names), *sorted(names - set(CLASSES))][:MOST_CLASSES]
