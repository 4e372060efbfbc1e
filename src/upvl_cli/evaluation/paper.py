"""The tables of the UP-VL paper as published, and the preset that makes each row here.

Source: Najibi et al., Unsupervised 3D Perception with 2D Vision-Language Distillation for Autonomous Driving,
ICCV 2023; its MI-UP rows are of Najibi et al., Motion Inspired Unsupervised Perception and Prediction in
Autonomous Driving, ECCV 2022. All of them are of the Waymo Open Dataset, in percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NOT_PUBLISHED = float("nan")
VISION = ("extract-vl",)
DETECTOR = ("extract-vl", "train", "detect")

Score = Literal["class-agnostic", "named", "tracking"]


@dataclass(frozen=True)
class PaperRow:
    """One row of a table.

    Attributes:
        name: Name of the method in the paper, or a description.
        preset: Folder of `stages/presets`; empty for the values that ship.
        published: Figure of each column, in percent.
        what: "labels" or "detections".
        needs: Stages that make it, beside those of all rows.
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
        title: Title, with the number of the table in the paper.
        score: Kind of score, which decides the columns.
        moving_only: Whether only moving labels count.
        rows: The methods that are compared.
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
            PaperRow(
                "clustering, whatever the class", "clustering", (NOT_PUBLISHED, NOT_PUBLISHED, 11.6), needs=()
            ),
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
            # The paper does not say whether these are of labels or of a detector trained on them.
            PaperRow("MI-UP (here: its labels)", "moving-only", (12.8, 45.5), needs=()),
            PaperRow("MI-UP-C + VL (here: its labels)", "moving-vl", (22.8, 43.4)),
            PaperRow("UP-VL detector", "moving-vl", (41.3, 37.4), "detections", DETECTOR),
        ),
    ),
    PaperTable(
        "Ablation: cosine from which a point is background (eps_bg)",
        "named",
        False,
        tuple(
            # Ours are on the cosine scale of `mini`, another one than that of the paper's model.
            PaperRow(f"eps_bg = {value} (here {ours})", preset, (NOT_PUBLISHED, NOT_PUBLISHED, published))
            for value, ours, preset, published in (
                ("0.10", "0.4", "eps-bg-10", 20.5),
                ("0.05", "0.2", "eps-bg-05", 21.9),
                ("0.02", "0.08", "", 22.4),
                ("0.00", "-0.1", "eps-bg-00", 22.1),
            )
        ),
    ),
    PaperTable(
        "Ablation: share of background points above which a box is dropped (r_bg)",
        "named",
        False,
        tuple(
            PaperRow(f"r_bg = {value} %", preset, (NOT_PUBLISHED, NOT_PUBLISHED, published))
            for value, preset, published in (
                (50, "r-bg-50", 14.1),
                (90, "r-bg-90", 19.2),
                (99, "", 22.4),
                (100, "r-bg-100", 22.3),
            )
        ),
    ),
)
