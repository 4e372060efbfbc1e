"""Random streets to score, and short ways to write a few boxes."""

from __future__ import annotations

from typing import Any

import numpy as np

from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.types import Array

CAR = (4.0, 2.0, 1.5)


def box(
    x: float, y: float = 0.0, heading: float = 0.0, size: tuple[float, float, float] = CAR
) -> list[float]:
    """A box on flat ground."""
    return [x, y, size[2] / 2, *size, heading]


def labels(boxes: Any, **columns: Any) -> Truth:
    """Labels of one frame: cars of level 1 that stand, unless a column says otherwise."""
    n = len(boxes)
    defaults = {
        "sequence": ["s"] * n,
        "frame": [0] * n,
        "type": [1] * n,
        "level": [1] * n,
        "velocity_mps": np.zeros((n, 2)),
        "object_id": [f"g{i}" for i in range(n)],
    }
    return Truth.from_rows(np.reshape(boxes, (n, 7)), **(defaults | columns))


def guesses(boxes: Any, **columns: Any) -> Predictions:
    """Predictions of one frame: cars of score 0.9 without speed, unless a column says otherwise."""
    n = len(boxes)
    defaults = {
        "sequence": ["s"] * n,
        "frame": [0] * n,
        "type": [1] * n,
        "score": [0.9] * n,
        "velocity_mps": np.full((n, 2), np.nan),
        "object_id": [f"p{i}" for i in range(n)],
        "unlabelled": [False] * n,
    }
    return Predictions.from_rows(np.reshape(boxes, (n, 7)), **(defaults | columns))


def random_street(
    seed: int, *, frames: int, objects: int, side_m: float, grid_m: float = 0.0
) -> tuple[Truth, Predictions]:
    """Moving objects of two segments, and predictions that miss, double, invent, swap and lose ids.

    With `grid_m`, places snap to a grid and headings to quarter turns, so that many overlaps are equal.
    """
    rng = np.random.default_rng(seed)
    n = frames * objects
    frame, number = np.repeat(np.arange(frames), objects), np.tile(np.arange(objects), frames)
    place = rng.uniform(-side_m, side_m, (objects, 2))[number] + rng.normal(0, 0.4, (n, 2))
    velocity = rng.choice([0.0, 0.1, 0.5, 2.0, 8.0, 15.0], (objects, 2))[number]
    kind = rng.integers(0, 5, objects)[number]
    heading = rng.uniform(-4, 4, objects)[number]
    rows = np.column_stack([place, np.full(n, 0.75), np.full((n, 3), CAR), heading])
    seen = rng.random(n) < 0.8
    sequence = np.where(frame < frames // 2, "b", "a")
    names = np.array([f"g{i}" for i in range(objects)])[number]
    columns = {
        "sequence": sequence,
        "frame": frame,
        "type": kind,
        "level": rng.integers(0, 3, n),
        "velocity_mps": velocity,
        "object_id": names,
    }
    truth = Truth.from_rows(snap(rows, grid_m), **columns)[seen]
    return truth, _predictions_near(truth, rng, grid_m)


def _predictions_near(truth: Truth, rng: np.random.Generator, grid_m: float) -> Predictions:
    source = rng.choice(len(truth), int(1.2 * len(truth)))
    near = truth[source]
    n = len(source)
    rows = near.to_rows()
    rows[:, :2] += rng.normal(0, 0.5, (n, 2)) * rng.choice([0.2, 1, 10], (n, 1), p=[0.5, 0.4, 0.1])
    rows[:, 6] += rng.choice([0, np.pi], n) + rng.normal(0, 0.05, n)
    names = np.where(rng.random(n) < 0.9, np.char.replace(near.object_id, "g", "p"), "p0")
    velocity = np.where(rng.random((n, 1)) < 0.2, np.nan, near.velocity_mps + rng.normal(0, 0.3, (n, 2)))
    score = np.clip(np.round(rng.random(n), 2), 0, 1)
    return Predictions.from_rows(
        snap(rows, grid_m),
        sequence=near.sequence,
        frame=near.frame,
        type=near.type,
        score=score,
        velocity_mps=velocity,
        object_id=names,
        unlabelled=rng.random(n) < 0.1,
    )


def snap(rows: Array, grid_m: float) -> Array:
    """(n, 7) boxes on a grid, with headings of quarter turns; as they are where there is no grid."""
    if not grid_m:
        return rows
    out = rows.copy()
    out[:, :2] = np.round(out[:, :2] / grid_m) * grid_m
    out[:, 6] = np.round(out[:, 6] / (np.pi / 2)) * (np.pi / 2)
    return out
