"""Objects of one sweep: points that are close in space and in motion, and the tightest box of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.box_fit import rectangle_heading, tight_box
from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.proposals.crowd import split_crowd
from upvl_cli.perception.proposals.persistence import Places
from upvl_cli.types import Array, Bools, Floats, Ints

TRIM = 0.01  # share of the points left out at each end of length and width: single stray returns
MARGIN_M = 0.1  # a point this far outside a box may still join it: about the edge of a voxel
STAND_M = 1.5  # what moves stands on the ground; an object seen only above this may hang over the road
FAN_STEP_RAD = float(np.deg2rad(1.0))  # headings tried for an object that stands still
EDGE_FLOOR_M = 0.05  # about the range noise of a LiDAR: closer to an edge is not better
SPANS_S = (0.5, 1.0, 2.0)  # the first in which an object clears its place tells what does not belong to it
GLASS_M = 1.0  # glass returns nothing: a roof this far above its doors is theirs
CLEARANCE_M = 0.3  # on top of its own length, as places are told apart by about this much


@dataclass(frozen=True)
class Proposals:
    """Boxes of one sweep, in the axes of its points.

    Attributes:
        seven: (k, 7) boxes.
        velocity_mps: (k, 3) median flow of the points of each box.
        points: (k,) how many points each box was fitted to.
        of_point: (n,) number of the box that each point belongs to, -1 for none.
        dropped: How many points and clusters were left out, by reason.
    """

    seven: Array
    velocity_mps: Array
    points: Ints
    of_point: Ints
    dropped: dict[str, int]


@dataclass(frozen=True)
class Sweep:
    """The points of one sweep that stand above the ground.

    Attributes:
        xyz_m: (n, 3) points.
        velocity_mps: (n, 3) their motion over the ground, along the axes of the points.
        candidate: (n,) whether the point passed the motion mask; all of them for every motion state.
            The others only join a box that they lie in: flow misses points here and there.
        background: (n,) 1 where the point shows background, 0 where not, negative where nobody knows.
        look: (n, k) what else neighbours are to be alike in, in metres; k may be 0.
        height_m: (n,) heights over the ground.
        world_from_sweep: (4, 4) pose of the axes of the points.
        step: Number of the sweep among `Places`.
    """

    xyz_m: Floats
    velocity_mps: Floats
    candidate: Bools
    background: Ints
    look: Floats
    height_m: Floats
    world_from_sweep: Floats
    step: int


def propose(
    sweep: Sweep,
    places: Places,
    *,
    eps_m: float,
    eps_deg: float,
    eps_mps: float,
    min_points: int,
    voxel_m: float,
    cluster_background: bool,
    max_background_share: float,
    max_lasting_share: float,
    moving_mps: float,
    foot_m: float,
    person_gap_m: float,
) -> Proposals:
    """Cluster the points that may be objects, and fit a box to each cluster (MI-UP, section 4.2).

    Position and flow are clustered together: neighbours are close in both at once, so that a walker
    and the wall behind him, or two cars that pass, never join through a chain of other points.

    Args:
        sweep: The points.
        places: Where matter stood in all sweeps of the drive.
        eps_m: Neighbours are closer than this; up and down they may be `GLASS_M` apart.
        eps_deg: Or closer than this as the car sees them: far away its beams are farther apart.
        eps_mps: And their flow differs by less than this; the two add up as in Pythagoras' rule.
        min_points: Points that make a neighbourhood dense, and the fewest of an object.
        voxel_m: Points closer than this count as one place.
        cluster_background: Whether background points make clusters too, as in the paper; otherwise they join
            what they lie in.
        max_background_share: An object with a larger share of background points is dropped: r_bg. Only points
            of which it is known whether they are background count.
        max_lasting_share: So is one that claims to leave its place while more of its points than this
            stay taken before and after.
        moving_mps: From this speed on the flow gives the heading, below it the shape.
        foot_m: Points lower than this (kerbs, ground) have no say in length, width and heading.
        person_gap_m: Persons this far apart are not one object, though their cluster is.
    """
    label: Ints = np.full(len(sweep.xyz_m), NOISE, dtype=np.int64)
    candidate = sweep.candidate & (cluster_background | (sweep.background != 1))
    upright = sweep.xyz_m * [1.0, 1.0, min(1.0, eps_m / GLASS_M)]
    joint = np.hstack([upright, sweep.velocity_mps * (eps_m / eps_mps), sweep.look])[candidate]
    reach_m = np.maximum(eps_m, np.deg2rad(eps_deg) * np.hypot(*sweep.xyz_m[candidate, :2].T))
    label[candidate] = dbscan_voxels(
        joint, eps_m=eps_m, min_points=min_points, voxel_m=voxel_m, reach_m=reach_m
    )
    dropped = {"points in no cluster": int((label[candidate] == NOISE).sum())}
    if cluster_background:  # there are many: before their boxes are fitted
        label, dropped["background"] = _drop(label, _background(label, sweep) > max_background_share)
    label = _persons(label, sweep, foot_m, person_gap_m)

    velocity = _velocities(label, sweep)
    label = _adopt(label, sweep.xyz_m, _fit_all(label, velocity, sweep, moving_mps, foot_m))
    if not cluster_background:
        label, dropped["background"] = _drop(label, _background(label, sweep) > max_background_share)
        velocity = _velocities(label, sweep)
    lasting = _lasting(label, velocity, _fit_all(label, velocity, sweep, moving_mps, foot_m), sweep, places)
    label, dropped["stays where it is"] = _drop(label, _share(label, lasting) > max_lasting_share)
    dropped["points that stay"] = int((lasting & (label != NOISE)).sum())
    label[lasting] = NOISE
    label, dropped["too few points"] = _drop(label, _count(label) < min_points)

    velocity = _velocities(label, sweep)
    boxes = _fit_all(label, velocity, sweep, moving_mps, foot_m)
    return Proposals(boxes, velocity, _count(label), label, dropped)


def _persons(label: Ints, sweep: Sweep, foot_m: float, gap_m: float) -> Ints:
    """The labels with crowds split: the first person keeps the number, the others get new ones."""
    label = label.copy()
    total = label.max(initial=NOISE) + 1
    for of in _members(label):
        body = of[sweep.height_m[of] >= foot_m]
        person = split_crowd(sweep.xyz_m[body], gap_m=gap_m)
        others = person > 0
        label[body[others]] = total + person[others] - 1
        total += person.max(initial=0)
    return label


def _members(label: Ints) -> Sequence[Ints]:
    """The points of each cluster."""
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(label.max(initial=NOISE) + 1))
    return np.split(order, starts)[1:]


def _count(label: Ints) -> Ints:
    return np.bincount(label[label != NOISE], minlength=label.max(initial=NOISE) + 1)


def _share(label: Ints, flag: Bools) -> Array:
    """Share of the points of each cluster that carry a flag."""
    hits = np.bincount(label[(label != NOISE) & flag], minlength=label.max(initial=NOISE) + 1)
    return hits / np.maximum(_count(label), 1)


def _background(label: Ints, sweep: Sweep) -> Array:
    """Share of background among the points of each cluster whose state is known; 0 where it is of none."""
    known = (label != NOISE) & (sweep.background >= 0)
    total = label.max(initial=NOISE) + 1
    count = np.bincount(label[known], minlength=total)
    return np.bincount(label[known], sweep.background[known], minlength=total) / np.maximum(count, 1)


def _drop(label: Ints, gone: Bools) -> tuple[Ints, int]:
    """The labels without the clusters that are gone, numbered anew, and how many those were."""
    number = np.where(gone, NOISE, np.cumsum(~gone) - 1)
    return np.append(number, NOISE)[label], int(gone.sum())  # the last entry is that of NOISE = -1


def _velocities(label: Ints, sweep: Sweep) -> Array:
    """(k, 3) median motion of the points of each cluster that passed the motion mask."""
    own = np.where(sweep.candidate, label, NOISE)
    return np.array([np.median(sweep.velocity_mps[of], axis=0) for of in _members(own)]).reshape(-1, 3)


def _fit_all(label: Ints, velocity: Array, sweep: Sweep, moving_mps: float, foot_m: float) -> Array:
    boxes = [
        _fit(sweep.xyz_m[of], sweep.height_m[of], motion, moving_mps, foot_m)
        for of, motion in zip(_members(label), velocity, strict=True)
    ]
    return np.array(boxes).reshape(-1, 7)


def _fit(xyz_m: Array, height_m: Array, velocity_mps: Array, moving_mps: float, foot_m: float) -> Array:
    body = height_m >= foot_m
    if not body.any():
        body = np.ones(len(xyz_m), dtype=np.bool_)
    if np.hypot(*velocity_mps[:2]) >= moving_mps:
        heading = float(np.arctan2(velocity_mps[1], velocity_mps[0]))
    else:
        heading = rectangle_heading(xyz_m[body, :2], step_rad=FAN_STEP_RAD, floor_m=EDGE_FLOOR_M)
    box = tight_box(xyz_m[body], heading, trim=TRIM)
    low, high = xyz_m[:, 2].min(), xyz_m[:, 2].max()
    if height_m.min() < STAND_M:
        low = np.median(xyz_m[:, 2] - height_m)
    box[2], box[5] = (low + high) / 2, high - low
    return box


def _adopt(label: Ints, xyz_m: Floats, boxes: Array) -> Ints:
    """Points without a cluster join the box that they lie in; the smallest one where boxes overlap."""
    box, point = pairs_inside(xyz_m, boxes, margin_m=MARGIN_M)
    free = label[point] == NOISE
    box, point = box[free], point[free]
    order = np.argsort(-boxes[box, 3:6].prod(axis=1), kind="stable")
    label = label.copy()
    label[point[order]] = box[order]
    return label


def _lasting(label: Ints, velocity: Array, boxes: Array, sweep: Sweep, places: Places) -> Bools:
    """Which points of clusters lie where there is matter too when the cluster is elsewhere."""
    clears_s = (boxes[:, 3] + CLEARANCE_M) / np.maximum(np.linalg.norm(velocity[:, :2], axis=1), 1e-9)
    choice = np.searchsorted(SPANS_S, clears_s)  # the first span that is long enough; none for slow ones
    of_point = np.append(choice, len(SPANS_S))[label]
    lasting = np.zeros(len(label), dtype=np.bool_)
    for number, span_s in enumerate(SPANS_S):
        asked = np.flatnonzero(of_point == number)
        lasting[asked] = places.lasting(sweep.step, span_s, apply(sweep.world_from_sweep, sweep.xyz_m[asked]))
    return lasting
