"""How boxes differ from the labels that they find: size, place, heading, speed, ids, and the gain over visible boxes.

A label is found by the box that overlaps it most from above, at bird's-eye IoU 0.3 or more; so a box that stands too
low or too high counts as found, and its error is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.evaluation.gather import Material
from upvl_cli.geometry.iou import iou_3d_pairs, iou_bev
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, speed_mps
from upvl_cli.types import Boxes

FOUND_IOU = 0.3
FEWEST_POINTS = 30  # of a label whose size can be asked for
PARTLY, FULLY = 0.7, 0.9  # share of a label's footprint that the visible box covers
VEHICLE_M = 3.0  # a label at least so long


@dataclass(frozen=True)
class BoxErrors:
    """Medians over the moving labels that were found; NaN where none was.

    Attributes:
        found: Share of the moving labels with `FEWEST_POINTS` that are found.
        length_m: Bias of the length: median of box minus label.
        length_two_m: Median of the absolute error of the length, where two sides are turned to the sensor.
        bottom_m: Bias of the height of the bottom.
        across_m: Bias of the place across the label.
        heading_deg: Median of the error of the axis.
        flips: Share of boxes that look to the back.
        speed_mps: Median of the absolute error of the speed.
        switches: Changes of id for each label track that was found.
    """

    found: float
    length_m: float
    length_two_m: float
    bottom_m: float
    across_m: float
    heading_deg: float
    flips: float
    speed_mps: float
    switches: float


def matches(truth: Truth, boxes: Predictions) -> tuple[np.ndarray, np.ndarray]:
    """Rows of labels and of boxes that belong together."""
    labels, found = [], []
    here = _rows_by_frame(truth)
    for key, rows in _rows_by_frame(boxes).items():
        mine = here.get(key)
        if mine is None:
            continue
        iou = iou_bev(truth[mine], boxes[rows])
        for row, column in zip(*linear_sum_assignment(iou, maximize=True), strict=True):
            if iou[row, column] >= FOUND_IOU:
                labels.append(mine[row])
                found.append(rows[column])
    return np.array(labels, dtype=np.int64), np.array(found, dtype=np.int64)


def _rows_by_frame(boxes: Truth | Predictions) -> dict[tuple[str, int], np.ndarray]:
    rows: dict[tuple[str, int], list[int]] = {}
    for row, key in enumerate(zip(boxes.sequence.tolist(), boxes.frame.tolist(), strict=True)):
        rows.setdefault(key, []).append(row)
    return {key: np.array(values) for key, values in rows.items()}


def box_errors(material: Material, moving_mps: float) -> BoxErrors:
    """Look at the moving labels of a drive."""
    asked = speed_mps(material.labels.velocity_mps) >= moving_mps
    asked &= (material.points >= FEWEST_POINTS) | (material.points < 0)
    truth = material.labels[asked]
    label, box = matches(truth, material.predictions)
    if not len(label):
        return BoxErrors(0.0 if len(truth) else np.nan, *(np.full(8, np.nan)))
    mine, other = truth[label], material.predictions[box]
    longer = other.size_lwh_m[:, 0] - mine.size_lwh_m[:, 0]
    bottom = (other.center_m - mine.center_m)[:, 2] - (other.size_lwh_m - mine.size_lwh_m)[:, 2] / 2
    off = other.center_m - mine.center_m
    across = off[:, 1] * np.cos(mine.heading_rad) - off[:, 0] * np.sin(mine.heading_rad)
    turned = np.abs((np.rad2deg(other.heading_rad - mine.heading_rad) + 180) % 360 - 180)
    speeds = np.abs(speed_mps(other.velocity_mps) - speed_mps(mine.velocity_mps))
    two = _sides_seen(mine) == 2
    return BoxErrors(
        found=len(np.unique(label)) / len(truth),
        length_m=float(np.median(longer)),
        length_two_m=float(np.median(np.abs(longer[two]))) if two.any() else np.nan,
        bottom_m=float(np.median(bottom)),
        across_m=float(np.median(across)),
        heading_deg=float(np.median(np.minimum(turned, 180 - turned))),
        flips=float((turned > 90).mean()),
        speed_mps=float(np.nanmedian(speeds)),
        switches=_switches(mine, other),
    )


def _sides_seen(labels: Boxes) -> np.ndarray:
    """How many upright sides of each box are turned to the car's origin."""
    cos, sin = np.cos(labels.heading_rad), np.sin(labels.heading_rad)
    x, y = labels.center_m[:, 0], labels.center_m[:, 1]
    along, across = np.abs(x * cos + y * sin), np.abs(y * cos - x * sin)
    outside = np.stack([along, across]) > labels.size_lwh_m[:, :2].T / 2 + 0.2
    return np.asarray(outside.sum(axis=0))


def _switches(mine: Truth, other: Predictions) -> float:
    """Count how often the id of the box changes along each label track, for each track."""
    name = np.char.add(np.char.add(mine.sequence.astype(str), "/"), mine.object_id.astype(str))
    order = np.lexsort((mine.frame, name))
    name, identity = name[order], other.object_id[order]
    changed = (name[1:] == name[:-1]) & (identity[1:] != identity[:-1])
    return float(changed.sum() / len(np.unique(name)))


def gains(material: Material, visible: dict[tuple[str, int, str], Boxes]) -> tuple[float, float, int]:
    """Mean 3D IoU gained over the visible boxes on vehicles seen partly and fully, and how many of both.

    Args:
        material: Labels and whole boxes.
        visible: The visible box that each box was made from, by segment, frame and track.
    """
    label, box = matches(material.labels, material.predictions)
    mine, whole = material.labels[label], material.predictions[box]
    keys = list(zip(whole.sequence.tolist(), whole.frame.tolist(), whole.object_id.tolist(), strict=True))
    kept = [row for row, key in enumerate(keys) if key in visible and mine.size_lwh_m[row, 0] >= VEHICLE_M]
    if not kept:
        return np.nan, np.nan, 0
    seen = [visible[keys[row]] for row in kept]
    before = Boxes(*(np.concatenate([getattr(one, name) for one in seen]) for name in _GEOMETRY))
    after, truth = (Boxes(*(getattr(side[kept], name) for name in _GEOMETRY)) for side in (whole, mine))
    gained = iou_3d_pairs(truth, after) - iou_3d_pairs(truth, before)
    share = np.prod(before.size_lwh_m[:, :2], axis=1) / np.prod(truth.size_lwh_m[:, :2], axis=1)
    partly, fully = gained[share < PARTLY], gained[share > FULLY]
    return (
        float(partly.mean()) if len(partly) else np.nan,
        float(fully.mean()) if len(fully) else np.nan,
        len(kept),
    )


_GEOMETRY = ("center_m", "size_lwh_m", "heading_rad")
