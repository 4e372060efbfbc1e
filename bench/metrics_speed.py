"""Print how long the scores of 200 frames with 100 boxes each take on one core; exits 1 above the bars."""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when numpy is imported

import resource
import sys
import time
from collections.abc import Callable

import numpy as np

from upvl_cli.metrics.waymo.breakdown import ALL_BUT_SIGN, OBJECT_TYPE, RANGE, SIZE, VELOCITY
from upvl_cli.metrics.waymo.detection import detection
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import IOU_THRESHOLDS, SCORE_CUTOFFS
from upvl_cli.metrics.waymo.tracking import tracking
from upvl_cli.types import Array

FRAMES, BOXES = 200, 100
SIZES = np.array([[4.6, 1.9, 1.7], [0.8, 0.8, 1.75], [0.6, 0.6, 0.8], [1.8, 0.8, 1.7]])


def street(crowding: float) -> tuple[Truth, Predictions]:
    """Return a drive of 100 objects in every frame and as many predictions.

    Predictions are labels moved a little; 15 % of them are false, 10 % are second boxes of one object,
    and a track changes its id about once in 60 frames.

    Args:
        crowding: Side of the square that holds all objects, in metres.
    """
    rng = np.random.default_rng(0)
    frame = np.repeat(np.arange(FRAMES), BOXES)
    number = np.tile(np.arange(BOXES), FRAMES)
    kind = rng.integers(1, 5, BOXES)
    velocity = rng.choice([0.0, 0.5, 2.0, 8.0, 15.0], BOXES)[:, None] * unit(
        rng.uniform(-np.pi, np.pi, BOXES)
    )
    place = (
        rng.uniform(-crowding / 2, crowding / 2, (BOXES, 2))[number] + 0.1 * frame[:, None] * velocity[number]
    )
    place = (place + crowding / 2) % crowding - crowding / 2
    size = SIZES[kind - 1][number]
    heading = rng.uniform(-np.pi, np.pi, BOXES)[number]
    rows = np.column_stack([place, size[:, 2] / 2, size, heading])
    names = np.array([f"object {i}" for i in range(BOXES)])
    level = rng.integers(1, 3, len(frame))
    truth = Truth.from_rows(
        rows,
        sequence=np.full(len(frame), "drive"),
        frame=frame,
        type=kind[number],
        level=level,
        velocity_mps=velocity[number],
        object_id=names[number],
    )
    return truth, predicted(truth, number, rng)


def unit(angle: Array) -> Array:
    """Return (n, 2) directions."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def predicted(truth: Truth, number: Array, rng: np.random.Generator) -> Predictions:
    """Return the labels with noise, some of them twice and some elsewhere."""
    n = len(truth)
    rows = truth.to_rows() * [1, 1, 1, *rng.normal(1, 0.05, 3), 1]
    rows[:, :2] += rng.normal(0, 0.08, (n, 2)) * truth.size_lwh_m[:, :2]
    rows[:, 6] += rng.normal(0, 0.05, n)
    source = np.arange(n)
    twice = rng.random(n) < 0.1
    source[twice] = np.roll(source, 1)[twice]  # mostly a neighbour in the list: the same frame
    rows[twice] = rows[source[twice]] + rng.normal(0, 0.05, (twice.sum(), 7))
    false = rng.random(n) < 0.15
    rows[false, :2] += rng.uniform(-20, 20, (false.sum(), 2))
    switches = np.cumsum(rng.random((FRAMES, BOXES)) < 1 / 60, axis=0).reshape(-1)
    track = np.where(twice, "twin ", "track ").astype("<U24")
    name = np.char.add(track, np.char.add(number.astype(str), np.char.add(".", switches.astype(str))))
    score = np.clip(np.where(false, rng.beta(2, 3, n), rng.beta(4, 2, n)), 0, 1)
    return Predictions.from_rows(
        rows,
        sequence=truth.sequence,
        frame=truth.frame,
        type=truth.type[source],
        score=score,
        velocity_mps=np.full((n, 2), np.nan),
        object_id=name,
        unlabelled=false & twice,
    )


def timed(what: str, score: Callable[..., object], bar_s: float, *args: object, **rule: object) -> bool:
    """Run once, print wall and processor seconds, and return whether the bar is met."""
    wall, cpu = time.perf_counter(), time.process_time()
    score(*args, **rule)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(
        f"{what:44} {wall:6.2f} s wall {cpu:6.2f} s CPU   bar {bar_s:.0f} s {'' if wall < bar_s else 'MISSED'}"
    )
    return wall < bar_s


def main() -> int:
    """Score three streets at two thresholds, all breakdowns and 101 cut-offs, and return the exit code."""
    splits = [OBJECT_TYPE, RANGE, SIZE, VELOCITY, ALL_BUT_SIGN]
    rule = {"breakdowns": splits, "score_cutoffs": SCORE_CUTOFFS, "matcher": "hungarian"}
    fine = True
    for side_m in (150.0, 25.0, 10.0):
        boxes = street(side_m)
        for thresholds in (IOU_THRESHOLDS, (0.0, 0.4, 0.4, 0.4, 0.4)):
            what = f"{FRAMES} x {BOXES} boxes in {side_m:3.0f} m, IoU {thresholds[1]}"
            fine &= timed(f"detection, {what}", detection, 20, *boxes, iou_thresholds=thresholds, **rule)
            fine &= timed(f"tracking,  {what}", tracking, 30, *boxes, iou_thresholds=thresholds, **rule)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024} MiB")
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
