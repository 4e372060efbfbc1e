"""Object proposals of one sweep: clusters of points in position and motion, and the tightest box of each.

UP-VL, Algorithm 1, line 6; the clustering is that of MI-UP, Section 4.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.proposals.cluster_fits import ClusterFits, Sweep
from upvl_cli.perception.proposals.clusters import (
    background_share,
    cluster_sizes,
    drop_clusters,
    flagged_share,
    median_velocities,
)
from upvl_cli.perception.proposals.config import (
    ClusteringConfig,
    ProposalBoxConfig,
    ProposalConfig,
)
from upvl_cli.perception.proposals.crowd import split_crowds
from upvl_cli.perception.proposals.persistence import OccupancyHistory
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints

_MIN_SPEED_MPS = 1e-9  # below any flow: an object that stands still never clears its place


@dataclass(frozen=True)
class Proposals:
    """Boxes of one sweep, in the axes of its points.

    Attributes:
        boxes: k boxes.
        velocity_mps: (k, 3) median flow of the points of each box.
        num_points: (k,) number of points that each box was fitted to.
        box_of_point: (n,) number of the box that each point belongs to, -1 for none.
        dropped: Number of points and clusters that were left out, by reason.
    """

    boxes: Boxes
    velocity_mps: Array
    num_points: Ints
    box_of_point: Ints
    dropped: dict[str, int]


def propose(sweep: Sweep, history: OccupancyHistory, config: ProposalConfig) -> list[Proposals]:
    """Cluster the points that may be objects, and fit a box to each cluster (MI-UP, Section 4.2).

    Position and flow are clustered together: neighbors are close in both at once, so that a walker
    and the wall behind him, or two cars that pass, never join through a chain of other points.

    Args:
        sweep: The points.
        history: Occupied places in all sweeps of the drive.
        config: Settings of each step.

    Returns:
        The proposals of each hypothesis: one for each radius of the clustering, in its order.
    """
    fits = ClusterFits(sweep, config)
    return [_propose(sweep, history, fits, eps_m, config) for eps_m in config.clustering.eps_m]


def lift(sweep: Sweep, label: Ints, config: ProposalConfig) -> Proposals:
    """Return the boxes around objects that 2D boxes show: a hypothesis of its own.

    Args:
        sweep: The points.
        label: (n,) object of each point, -1 for none; those without a point that passed the motion mask are dropped.
        config: Settings of the boxes.
    """
    label, _ = drop_clusters(label, flagged_share(label, sweep.is_candidate) == 0)
    velocity_mps = _velocities(label, sweep)
    boxes = ClusterFits(sweep, config).boxes(label, velocity_mps)
    return Proposals(boxes, velocity_mps, cluster_sizes(label), label, {})


def _propose(
    sweep: Sweep, history: OccupancyHistory, fits: ClusterFits, eps_m: float, config: ProposalConfig
) -> Proposals:
    background, dropped = config.background, dict[str, int]()
    is_clustered = sweep.is_candidate & (background.cluster | (sweep.background != 1))
    label = _cluster(sweep, is_clustered, eps_m, config.clustering)
    dropped["points in no cluster"] = int((label[is_clustered] == NOISE).sum())
    dropped["background"] = 0
    # Clusters of background are many: they are dropped before a box is fitted to each.
    if background.drop and background.cluster:
        label, dropped["background"] = _drop_background(label, sweep, background.max_share)
    label = _split_crowds(label, sweep, config)

    velocity_mps = _velocities(label, sweep)
    boxes = fits.boxes(label, velocity_mps)
    label = _adopt_free_points(label, sweep.xyz_m, boxes, config.box)
    if not background.cluster:
        if background.drop:
            label, dropped["background"] = _drop_background(label, sweep, background.max_share)
        velocity_mps = _velocities(label, sweep)
    persistent = _persistent_points(label, velocity_mps, fits, history)
    is_dropped = flagged_share(label, persistent) > config.persistence.max_share
    label, dropped["persistent"] = drop_clusters(label, is_dropped)
    dropped["persistent points"] = int((persistent & (label != NOISE)).sum())
    label[persistent] = NOISE
    label, dropped["too few points"] = drop_clusters(
        label, cluster_sizes(label) < config.clustering.min_points
    )
    velocity_mps = _velocities(label, sweep)
    boxes = fits.boxes(label, velocity_mps)
    return Proposals(boxes, velocity_mps, cluster_sizes(label), label, dropped)


def _cluster(sweep: Sweep, is_clustered: Bools, eps_m: float, config: ClusteringConfig) -> Ints:
    """Return (n,) cluster of each point by position, velocity and features together, in metres; -1 for none."""
    label: Ints = np.full(len(sweep.xyz_m), NOISE, dtype=np.int64)
    position = sweep.xyz_m * [1.0, 1.0, min(1.0, eps_m / config.vertical_eps_m)]
    columns: list[Array] = [position]
    if config.use_velocity:
        columns.append(sweep.velocity_mps * (eps_m / config.velocity_eps_mps))
    if config.use_vl:
        columns.append(sweep.vl_feature * (eps_m / config.vl_eps))
    reach_m = None
    if config.scale_with_range:
        range_m = np.hypot(*sweep.xyz_m[is_clustered, :2].T)
        reach_m = np.maximum(eps_m, np.deg2rad(config.angular_eps_deg) * range_m)
    label[is_clustered] = dbscan_voxels(
        np.hstack(columns)[is_clustered],
        eps_m=eps_m,
        min_points=config.min_points,
        voxel_m=config.voxel_m,
        reach_m=reach_m,
    )
    return label


def _drop_background(label: Ints, sweep: Sweep, max_share: float) -> tuple[Ints, int]:
    """Return the labels without clusters of background, and the number of those (UP-VL, Section 3.2)."""
    return drop_clusters(label, background_share(label, sweep.background) > max_share)


def _split_crowds(label: Ints, sweep: Sweep, config: ProposalConfig) -> Ints:
    """Return the labels with crowds split: the first person keeps the number, the others get new ones."""
    body = np.flatnonzero((label != NOISE) & (sweep.height_m >= config.box.ground_clearance_m))
    body = body[np.argsort(label[body], kind="stable")]
    person = split_crowds(sweep.xyz_m[body], label[body], config.crowd)
    total = int(label.max(initial=NOISE)) + 1
    further: Ints = np.zeros(total, dtype=np.int64)  # persons of each cluster beside the first one
    np.maximum.at(further, label[body], person)
    start = total + np.cumsum(further) - further
    is_further = person > 0
    crowd = body[is_further]
    label = label.copy()
    label[crowd] = start[label[crowd]] + person[is_further] - 1
    return label


def _velocities(label: Ints, sweep: Sweep) -> Array:
    """Return (k, 3) median velocity of the points of each cluster that passed the motion mask."""
    return median_velocities(np.where(sweep.is_candidate, label, NOISE), sweep.velocity_mps)


def _adopt_free_points(label: Ints, xyz_m: Floats, boxes: Boxes, config: ProposalBoxConfig) -> Ints:
    """Return the labels with each point without a cluster in the smallest of the boxes that it lies in."""
    box, point = pairs_inside(xyz_m, boxes, margin_m=config.adoption_margin_m)
    is_free = label[point] == NOISE
    box, point = box[is_free], point[is_free]
    volume_m3 = boxes.size_lwh_m.prod(axis=1)
    order = np.argsort(-volume_m3[box], kind="stable")
    label = label.copy()
    label[point[order]] = box[order]  # the smallest box is written last
    return label


def _persistent_points(
    label: Ints, velocity_mps: Floats, fits: ClusterFits, history: OccupancyHistory
) -> Bools:
    """Return (n,) which points of clusters lie where there is matter too when the cluster has moved away."""
    sweep, persistence = fits.sweep, fits.config.persistence
    spans_s = np.sort(persistence.spans_s)
    speed_mps = np.linalg.norm(velocity_mps[:, :2], axis=1)
    persistent = np.zeros(len(label), dtype=np.bool_)
    if not len(spans_s) or not (speed_mps * spans_s[-1] >= persistence.clearance_m).any():
        return persistent
    boxes = fits.boxes(label, velocity_mps)
    clears_after_s = (boxes.size_lwh_m[:, 0] + persistence.clearance_m) / np.maximum(
        speed_mps, _MIN_SPEED_MPS
    )
    # The first span that is long enough; none for slow ones.
    choice = np.searchsorted(spans_s, clears_after_s)
    span_of_point = np.append(choice, len(spans_s))[label]
    for number, span_s in enumerate(spans_s.tolist()):
        points = np.flatnonzero(span_of_point == number)
        xyz_world_m = apply(sweep.world_from_sweep, sweep.xyz_m[points])
        persistent[points] = history.is_persistent(sweep.step, span_s, xyz_world_m, persistence)
    return persistent
