"""Objects of one sweep: points that are close in space and in motion, and the tightest box of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.algorithms.box_fit import rectangle_heading, tight_box
from upvl_cli.algorithms.clustering import NOISE, dbscan_voxels
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.types import Array, Bools, Floats, Ints

FAN_STEP_RAD = np.deg2rad(1.0)  # headings tried for an object that stands still
EDGE_FLOOR_M = 0.05  # about the range noise of a LiDAR: closer to an edge is not better


@dataclass(frozen=True)
class Proposals:
    """Boxes of one sweep, in the axes of its points.

    Attributes:
        seven: (k, 7) boxes.
        velocity_mps: (k, 3) median flow of the points of each box.
        points: (k,) how many points each box was fitted to.
        of_point: (n,) number of the box that each point belongs to, -1 for none.
        dropped: How many points (noise) and clusters were left out, by reason.
    """

    seven: Array
    velocity_mps: Array
    points: Ints
    of_point: Ints
    dropped: dict[str, int]


def propose(
    xyz_m: Floats,
    velocity_mps: Floats,
    candidate: Bools,
    background: Floats,
    height_m: Floats,
    *,
    eps_m: float,
    eps_mps: float,
    min_points: int,
    voxel_m: float,
    max_background_share: float,
    moving_mps: float,
    foot_m: float,
    stand_m: float,
    trim: float,
    margin_m: float,
) -> Proposals:
    """Cluster the points that may be objects, and fit a box to each cluster (MI-UP, section 4.2).

    Position and flow are clustered together: neighbours are close in both at once, so that a walker
    and the wall behind him, or two cars that pass, never join through a chain of other points.

    Args:
        xyz_m: (n, 3) points above the ground.
        velocity_mps: (n, 3) their motion over the ground, along the axes of the points.
        candidate: (n,) whether the point passed the motion mask; all of them for every motion state.
            The others only join a box that they lie in: flow misses points here and there.
        background: (n,) whether the point shows background, or how surely, 0 to 1.
        height_m: (n,) heights over the ground.
        eps_m: Neighbours are closer than this.
        eps_mps: And their flow differs by less than this; the two add up as in Pythagoras' rule.
        min_points: Points that make a neighbourhood dense, and the fewest of an object.
        voxel_m: Points closer than this count as one place.
        max_background_share: An object with a larger share of background points is dropped.
        moving_mps: From this speed on the flow gives the heading, below it the shape.
        foot_m: Points lower than this (kerbs, ground) have no say in length, width and heading.
        stand_m: An object whose lowest point is lower than this stands on the ground.
        trim: Share of the points left out at each end of length and width.
        margin_m: A point this far outside the box may still join it.
    """
    label = np.full(len(xyz_m), NOISE, dtype=np.int64)
    joint = np.hstack([xyz_m, velocity_mps * (eps_m / eps_mps)])[candidate]
    label[candidate] = dbscan_voxels(joint, eps_m=eps_m, min_points=min_points, voxel_m=voxel_m)
    dropped = {"noise points": int((label[candidate] == NOISE).sum())}
    label, dropped["too few points"] = _drop(label, np.bincount(label[label >= 0]) < min_points)
    share = _means(background.astype(np.float64), label)
    label, dropped["background"] = _drop(label, share > max_background_share)
    velocity = np.array([np.median(velocity_mps[of], axis=0) for of in _members(label)]).reshape(-1, 3)

    def fit(label: Ints) -> Array:
        boxes = [
            _fit(xyz_m[of], height_m[of], motion, moving_mps, foot_m, stand_m, trim)
            for of, motion in zip(_members(label), velocity, strict=True)
        ]
        return np.array(boxes).reshape(-1, 7)

    label = _adopt(label, xyz_m, fit(label), margin_m)
    points = np.bincount(label[label >= 0], minlength=len(velocity))
    return Proposals(fit(label), velocity, points, label, dropped)


def _members(label: Ints) -> list[Ints]:
    """The points of each cluster."""
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(label.max(initial=-1) + 1))
    return np.split(order, starts)[1:]


def _means(values: Floats, label: Ints) -> Array:
    """The mean of the values of each cluster."""
    kept = label >= 0
    return np.bincount(label[kept], values[kept]) / np.maximum(np.bincount(label[kept]), 1)


def _drop(label: Ints, gone: Bools) -> tuple[Ints, int]:
    """The labels without the clusters that are gone, numbered anew, and how many those were."""
    number = np.where(gone, NOISE, np.cumsum(~gone) - 1)
    return np.append(number, NOISE)[label], int(gone.sum())  # the last entry is that of NOISE = -1


def _fit(
    xyz_m: Floats,
    height_m: Floats,
    velocity_mps: Floats,
    moving_mps: float,
    foot_m: float,
    stand_m: float,
    trim: float,
) -> Array:
    body = height_m >= foot_m
    if not body.any():
        body = np.ones(len(xyz_m), dtype=np.bool_)
    if np.hypot(*velocity_mps[:2]) >= moving_mps:
        heading = float(np.arctan2(velocity_mps[1], velocity_mps[0]))
    else:
        heading = rectangle_heading(xyz_m[body, :2], step_rad=float(FAN_STEP_RAD), floor_m=EDGE_FLOOR_M)
    box = tight_box(xyz_m[body], heading, trim=trim)
    low, high = xyz_m[:, 2].min(), xyz_m[:, 2].max()
    if height_m.min() < stand_m:
        low = min(low, np.median(xyz_m[:, 2] - height_m))
    box[2], box[5] = (low + high) / 2, high - low
    return box


def _adopt(label: Ints, xyz_m: Floats, boxes: Array, margin_m: float) -> Ints:
    """Points without a cluster join the box that they lie in; the smallest one where boxes overlap."""
    box, point = pairs_inside(xyz_m, boxes, margin_m=margin_m)
    free = label[point] == NOISE
    box, point = box[free], point[free]
    order = np.argsort(-boxes[box, 3:6].prod(axis=1), kind="stable")
    label = label.copy()
    label[point[order]] = box[order]
    return label
