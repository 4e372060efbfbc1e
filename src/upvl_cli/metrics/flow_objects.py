"""Scene flow by object: whether the mean flow of each object's points is its motion.

Points of near objects outnumber those of far ones by thousands; what a tracker needs is one motion for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.types import Array, Bools, ParallelArrays, array

# What counts as right, and which objects count; they define the score, so no setting changes them.
RIGHT_SHARE = 0.2  # error of the mean flow as a share of the true speed
RIGHT_M = 0.1  # or as a way over the interval
MIN_POINTS = 30
STANDING_MPS = 0.2  # up to this true speed an object stands


@dataclass(frozen=True)
class ObjectFlows(ParallelArrays):
    """Objects in sweeps, each with the mean flow of its points.

    Attributes:
        predicted_mps: (n, 3) mean flow.
        true_mps: (n, 3) true velocity over the ground, in the same axes.
        range_m: (n,) distance from the car.
        points: (n,) points that the mean is of.
        moving_points: (n,) how many of them have a flow of at least the speed from which objects move.
        interval_s: (n,) time to the sweep that the flow leads to.
    """

    predicted_mps: Array = array("float64", 3)
    true_mps: Array = array("float64", 3)
    range_m: Array = array("float64")
    points: Array = array("int64")
    moving_points: Array = array("int64")
    interval_s: Array = array("float64")


@dataclass(frozen=True)
class MovingShare:
    """How many moving objects of one kind were given their motion; NaN where there is none.

    Attributes:
        name: The kind.
        objects: How many there are.
        right: Share whose mean flow is right.
        standing: Share whose mean flow is below a quarter of their speed.
    """

    name: str
    objects: int
    right: float
    standing: float


@dataclass(frozen=True)
class ObjectFlowScore:
    """Score over objects with 30 points or more, one in several sweeps counting as often.

    Attributes:
        moving: Moving objects: all, then by range, then by speed.
        standing_objects: How many stand.
        called_moving: Share of them whose mean flow is that of a moving object.
        points_called_moving: The same share of their points.
        speed_error_mps: Median error of the speed of moving objects that were given their motion.
    """

    moving: tuple[MovingShare, ...]
    standing_objects: int
    called_moving: float
    points_called_moving: float
    speed_error_mps: float


def is_right(flows: ObjectFlows) -> Bools:
    """Return (n,) whether the mean flow is within 20 % or 0.1 m an interval of the truth, horizontally, and not 0.

    Args:
        flows: Objects.
    """
    speed_mps = np.linalg.norm(flows.true_mps[:, :2], axis=1)
    error_mps = np.linalg.norm((flows.predicted_mps - flows.true_mps)[:, :2], axis=1)
    is_near = (error_mps <= RIGHT_SHARE * speed_mps) | (error_mps * np.abs(flows.interval_s) <= RIGHT_M)
    return np.asarray(is_near & (flows.predicted_mps != 0).any(axis=1))


def object_flow_score(
    flows: ObjectFlows,
    *,
    moving_mps: float,
    range_edges_m: Sequence[float],
    speed_edges_mps: Sequence[float],
) -> ObjectFlowScore:
    """Return the score of objects.

    Args:
        flows: Objects; those with fewer than 30 points do not count.
        moving_mps: Speed from which an object moves.
        range_edges_m: Distances that split moving objects into groups.
        speed_edges_mps: Speeds that do.
    """
    flows = flows[flows.points >= MIN_POINTS]
    speed_mps, found_mps = (
        np.linalg.norm(values[:, :2], axis=1) for values in (flows.true_mps, flows.predicted_mps)
    )
    right, moves, stands = is_right(flows), speed_mps >= moving_mps, speed_mps < STANDING_MPS
    missed = found_mps < speed_mps / 4

    def share(name: str, chosen: Bools) -> MovingShare:
        return MovingShare(name, int(chosen.sum()), _mean(right[chosen]), _mean(missed[chosen]))

    groups = [("all", moves)]
    for values, edges, unit in ((flows.range_m, range_edges_m, "m"), (speed_mps, speed_edges_mps, "m/s")):
        bounds = [0.0, *edges, np.inf]
        for low, high in zip(bounds, bounds[1:], strict=False):
            name = f"from {low:g} {unit}" if high == np.inf else f"{low:g} to {high:g} {unit}"
            groups.append((name, moves & (values >= low) & (values < high)))
    errors_mps = np.abs(found_mps - speed_mps)[moves & right]
    standing_points = int(flows.points[stands].sum())
    return ObjectFlowScore(
        moving=tuple(share(name, chosen) for name, chosen in groups if name == "all" or chosen.any()),
        standing_objects=int(stands.sum()),
        called_moving=_mean(found_mps[stands] > moving_mps),
        points_called_moving=float(flows.moving_points[stands].sum()) / max(standing_points, 1),
        speed_error_mps=float(np.median(errors_mps)) if len(errors_mps) else float("nan"),
    )


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
