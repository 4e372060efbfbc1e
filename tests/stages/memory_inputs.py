"""Inputs of a stage that stand in memory: rows written by hand, and sweeps that need no file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from upvl_cli.pipeline.stage import ALL_FRAMES, FrameWindow
from upvl_cli.stages.picture_rows import Boxes2dRow, LooksRow
from upvl_cli.stages.rows import AmodalRow, ClassifyRow
from upvl_cli.types import Boxes, Boxes2d, Camera, Points, empty

SEGMENT = "drive"


@dataclass
class MemoryDrive:
    """Sweeps by frame."""

    xyz_ego_m: dict[int, np.ndarray]
    cameras: tuple[Camera, ...] = ()

    def points(self, frame: int) -> Points:
        xyz = self.xyz_ego_m[frame]
        zeros = np.zeros(len(xyz))
        return Points(xyz, zeros, zeros, zeros, zeros)


class MemoryTable(list[Any]):
    """Rows that are found by their frame."""

    @property
    def frames(self) -> tuple[int, ...]:
        return tuple(row.frame for row in self)

    def __getitem__(self, frame: Any) -> Any:
        return next(row for row in self if row.frame == frame)


@dataclass
class MemoryInputs:
    """Rows of other stages by name, and what is counted."""

    tables: dict[str, list[Any]]
    drive: MemoryDrive | None = None
    model: Any = None
    segment: str = SEGMENT
    window: FrameWindow = ALL_FRAMES
    counts: Counter[str] = field(default_factory=Counter)

    def table(self, name: str, row: type[Any], segment: str | None = None) -> MemoryTable:
        return MemoryTable(self.tables[name])

    def count(self, reason: str, items: int) -> None:
        self.counts[reason] += int(items)


def amodal_row(frame: int, boxes: Boxes, track_id: list[int], **values: Any) -> AmodalRow:
    """Boxes of tracks, standing still unless `values` say more."""
    total = len(boxes)
    columns = {
        "velocity_mps": np.zeros((total, 3)),
        "num_points": np.full(total, 10, np.int32),
        "score": np.linspace(0.9, 0.5, total),
        "background_share": np.zeros(total),
        "num_frames_seen": np.full(total, 3, np.int32),
        "objectness": np.full(total, 0.5),
        "sides_seen": np.full(total, 2, np.int8),
        "residual_m": np.full(total, 0.05),
    }
    return AmodalRow(
        SEGMENT,
        frame,
        time_ns=frame * 10**8,
        center_m=boxes.center_m,
        size_lwh_m=boxes.size_lwh_m,
        heading_rad=boxes.heading_rad,
        track_id=np.array(track_id, dtype=np.int64),
        **{**columns, **values},
    )


def looks_row(frame: int, track_id: list[int], looks: dict[int, np.ndarray] | None = None) -> LooksRow:
    """Labels of some tracks, of which some have a look with that feature."""
    features = [(looks or {}).get(track) for track in track_id]
    none = np.zeros(64, np.int8)
    return LooksRow(
        SEGMENT,
        frame,
        np.array(track_id, np.int64),
        np.array([feature is not None for feature in features], np.int32),
        np.array([none if feature is None else feature for feature in features], np.int8).reshape(-1, 64),
    )


def classify_row(
    frame: int, classes: list[tuple[int, int, str, float]], look: str = "", agree: bool = True
) -> ClassifyRow:
    """Track, number of the class, word and share of each label; all have the same word by looks."""
    track_id, number, word, share = zip(*classes, strict=True) if classes else ((), (), (), ())
    return ClassifyRow(
        SEGMENT,
        frame,
        np.array(track_id, np.int64),
        np.array(number, np.int8),
        np.array(word, np.str_),
        np.array(share, np.float32),
        np.full(len(word), 1 if look else 0, np.int32),
        np.array([[look, "", ""]] * len(word), np.str_).reshape(-1, 3),
        np.array([[0.5 if look else 0.0, 0, 0]] * len(word), np.float32).reshape(-1, 3),
        np.full(len(word), agree),
    )


def boxes2d_row(frame: int, boxes: Boxes2d | None = None, *, cameras: int = 0) -> Boxes2dRow:
    """2D boxes in the picture of the first of some cameras, taken at the time of the frame; none without a detector."""
    boxes = empty(Boxes2d) if boxes is None else boxes
    return Boxes2dRow(
        SEGMENT,
        frame,
        has_image=np.ones(cameras, bool),
        image_time_ns=np.full(cameras, frame * 10**8),
        camera=np.zeros(len(boxes), np.int8),
        xyxy_px=boxes.xyxy_px,
        score=boxes.score,
        name=boxes.name,
    )
