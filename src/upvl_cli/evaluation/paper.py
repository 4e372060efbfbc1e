"""The tables of the UP-VL paper, as published, and how each row is made here.

Source: Najibi et al., Unsupervised 3D Perception with 2D Vision-Language Distillation for Autonomous Driving,
ICCV 2023; its MI-UP rows are of Najibi et al., Motion Inspired Unsupervised Perception and Prediction in
Autonomous Driving, ECCV 2022. All of them are of the Waymo Open Dataset, in percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NOT_TOLD = float("nan")  # the paper gives no such figure
VISION = ("extract-vl",)
DETECTOR = ("extract-vl", "train", "detect")

Score = Literal["class-agnostic", "named", "tracking"]


@dataclass(frozen=True)
class PaperRow:
    """One row of a table.

    Attributes:
        name: What the paper calls it, or what it is.
        preset: Folder of `stages/presets`; empty for the values that ship.
        published: One figure a column, in percent.
        what: "labels" or "detections".
        needs: Stages that must exist to make it.
    """

    name: str
    preset: str
    published: tuple[float, ...]
    what: str = "labels"
    needs: tuple[str, ...] = VISION


@dataclass(frozen=True)
class PaperTable:
    """One table.

    Attributes:
        title: What it compares.
        score: How a row is scored; it decides the columns.
        moving_only: Whether only labels that move are asked for.
        rows: Its rows.
    """

    title: str
    score: Score
    moving_only: bool
    rows: tuple[PaperRow, ...]


COLUMNS: dict[Score, tuple[str, ...]] = {
    "class-agnostic": ("AP@0.4 L1", "AP@0.4 L2", "AP@0.5 L1", "AP@0.5 L2"),
    "named": ("vehicles", "VRU", "mAP"),
    "tracking": ("MOTA", "MOTP"),
}

TABLES = (
    PaperTable(
        "Table 1: moving objects, whatever their class",
        "class-agnostic",
        True,
        (
            PaperRow("MI-UP labels", "moving-only", (36.9, 35.5, 27.4, 26.4), needs=()),
            PaperRow(
                "MI-UP detector", "moving-only", (42.1, 40.4, 29.6, 28.4), "detections", ("train", "detect")
            ),
            PaperRow("UP-VL labels", "moving-vl", (39.9, 38.4, 34.2, 32.0)),
            PaperRow("UP-VL detector", "moving-vl", (49.9, 48.1, 38.4, 36.9), "detections", DETECTOR),
        ),
    ),
    PaperTable(
        "Table 2: moving objects by name",
        "named",
        True,
        (
            PaperRow("clustering + VL", "clustering-vl-moving", (47.8, 21.5, 34.7)),
            PaperRow("UP-VL labels", "moving-vl", (57.5, 29.8, 43.7)),
            PaperRow("UP-VL detector", "moving-vl", (76.9, 28.6, 52.8), "detections", DETECTOR),
        ),
    ),
    PaperTable(
        "Table 3: all objects by name",
        "named",
        False,
        (
            PaperRow("clustering, whatever the class", "clustering", (NOT_TOLD, NOT_TOLD, 11.6), needs=()),
            PaperRow("clustering + VL", "clustering-vl", (15.8, 9.9, 12.9)),
            PaperRow("clustering + VL + flow", "clustering-vl-flow", (16.1, 10.0, 13.1)),
            PaperRow("UP-VL labels", "", (30.2, 14.7, 22.4)),
            PaperRow(
                "detector without distillation", "no-distillation", (40.0, 15.2, 27.6), "detections", DETECTOR
            ),
            PaperRow("detector with distillation", "", (52.0, 19.7, 35.8), "detections", DETECTOR),
        ),
    ),
    PaperTable(
        "Table 4: tracks of moving objects",
        "tracking",
        True,
        (
            # Not told whether of labels or of a detector trained on them.
            PaperRow("MI-UP (here: its labels)", "moving-only", (12.8, 45.5), needs=()),
            PaperRow("MI-UP-C + VL (here: its labels)", "moving-vl", (22.8, 43.4)),
            PaperRow("UP-VL detector", "moving-vl", (41.3, 37.4), "detections", DETECTOR),
        ),
    ),
    PaperTable(
        "Ablation: background from this likeness on (eps_bg)",
        "named",
        False,
        tuple(
            # The values of the sweep stand on another scale here: that of `mini`.
            PaperRow(f"eps_bg = {value} (here {ours})", preset, (NOT_TOLD, NOT_TOLD, published))
            for value, ours, preset, published in (
                ("0.10", "0.4", "eps-bg-10", 20.5),
                ("0.05", "0.2", "eps-bg-05", 21.9),
                ("0.02", "0.08", "", 22.4),
                ("0.00", "-0.1", "eps-bg-00", 22.1),
            )
        ),
    ),
    PaperTable(
        "Ablation: dropped above this share of background (r_bg)",
        "named",
        False,
        tuple(
            PaperRow(f"r_bg = {value} %", preset, (NOT_TOLD, NOT_TOLD, published))
            for value, preset, published in (
                (50, "r-bg-50", 14.1),
                (90, "r-bg-90", 19.2),
                (99, "", 22.4),
                (100, "r-bg-100", 22.3),
            )
        ),
    ),
)
