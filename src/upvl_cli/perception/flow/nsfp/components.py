"""The components of NSFP++: points judged static, connected components, and the points that each may become."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.flow.displacement_vote import mean_nearest_m, start_hypotheses
from upvl_cli.perception.flow.groups import relabel, sample_groups, static_poses
from upvl_cli.perception.flow.nsfp.config import BoxQueryConfig, FlowComponentsConfig, NsfpPlusPlusConfig
from upvl_cli.perception.flow.surface import build_tree, estimate_surface, misfit
from upvl_cli.types import Array, Bools, Floats, Ints

NO_PARTNER_M = 2.0  # distance of a point without a partner when starts are compared


class FlowComponent(NamedTuple):
    """A connected component, and the points of the other sweep that it may correspond to.

    Attributes:
        point: (n,) its points, as indices into the sweep.
        near_m: (k, 3) points of the other sweep in its expanded box.
        target_m: (m, 3) those of them that are left by pruning.
        start_m: (3,) displacement from which its optimisation starts.
    """

    point: Ints
    near_m: Floats
    target_m: Floats
    start_m: Floats


def static_points(source_m: Floats, target_m: Floats, config: NsfpPlusPlusConfig) -> tuple[Bools, Bools]:
    """Return which points of a sweep, and which of the other one, are judged static.

    Args:
        source_m: (n, 3) points of the sweep.
        target_m: (m, 3) points of the other one, in the same axes.
        config: How they are found.
    """
    method = config.static.method
    if method == "none":
        return np.zeros(len(source_m), bool), np.zeros(len(target_m), bool)
    if method == "points":
        reach_m = config.static.max_distance_m
        found = (
            build_tree(others).query(points, distance_upper_bound=max(reach_m, 1e-9))[0] <= reach_m
            for points, others in ((source_m, target_m), (target_m, source_m))
        )
        of_source, of_target = found
        return of_source, of_target
    return _points_of_static_clusters(source_m, target_m, config)


def _points_of_static_clusters(
    source_m: Floats, target_m: Floats, config: NsfpPlusPlusConfig
) -> tuple[Bools, Bools]:
    cluster = _cluster(np.concatenate([source_m, target_m]), config.components)
    of_source, of_target = np.split(cluster, [len(source_m)])
    total = int(cluster.max(initial=NOISE)) + 1
    groups = sample_groups(source_m, of_source, total=total, max_points=config.static.screen_points)
    surface = estimate_surface(groups, build_tree(source_m), config.surface)
    at_rest = misfit(surface, build_tree(target_m), static_poses(groups))
    # A cluster of the other sweep alone may be what a component has become.
    static = np.flatnonzero((groups.size > 0) & (at_rest <= config.static.max_misfit))
    return relabel(of_source, static) >= 0, relabel(of_target, static) >= 0


def connected_components(
    source_m: Floats, target_m: Floats, dt_s: float, config: NsfpPlusPlusConfig
) -> list[FlowComponent]:
    """Return the components of a sweep that get a network.

    Args:
        source_m: (n, 3) points of the sweep.
        target_m: (m, 3) points of the other one, in the same axes.
        dt_s: Time from the one to the other.
        config: How they are found.
    """
    of_source, of_target = static_points(source_m, target_m, config)
    label = np.full(len(source_m), NOISE)
    label[~of_source] = _cluster(source_m[~of_source], config.components)
    candidate_m = target_m[~of_target] if config.static.target else target_m
    max_shift_m = config.query.max_speed_mps * abs(dt_s)
    order = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[order], np.arange(label.max(initial=NOISE) + 2))
    found = []
    for first, end in zip(bounds, bounds[1:], strict=False):
        point = order[first:end]
        points_m = source_m[point]
        near_m = candidate_m[_in_expanded_box(points_m, candidate_m, max_shift_m, config.query)]
        if len(near_m) < config.query.min_points:
            continue
        start_m = _start(points_m, near_m, max_shift_m, config)
        left_m = _prune(points_m, near_m, start_m) if config.query.prune else near_m
        if len(left_m) >= config.query.min_points:
            found.append(FlowComponent(point, near_m, left_m, start_m))
    return found


def _cluster(points_m: Floats, config: FlowComponentsConfig) -> Ints:
    return dbscan_voxels(points_m, eps_m=config.eps_m, min_points=config.min_points, voxel_m=config.voxel_m)


def _in_expanded_box(
    points_m: Floats, candidate_m: Floats, max_shift_m: float, config: BoxQueryConfig
) -> Bools:
    """Return which candidates are in the bird's-eye box of a component, expanded by the longest displacement."""
    low, high = points_m[:, :2].min(axis=0), points_m[:, :2].max(axis=0)
    size_m = high - low
    share = np.ones(2)
    if config.short_side == "proportional":
        share = size_m / max(size_m.max(), 1e-9)
    margin_m = share * max_shift_m
    xy_m = candidate_m[:, :2]
    return np.asarray(((xy_m >= low - margin_m) & (xy_m <= high + margin_m)).all(axis=1))


def _start(points_m: Floats, near_m: Floats, max_shift_m: float, config: NsfpPlusPlusConfig) -> Array:
    """Return the displacement from which the optimisation of a component starts."""
    if config.start == "rest":
        return np.zeros(3)
    shift_m = near_m.mean(axis=0) - points_m.mean(axis=0)
    shift_m[2] = 0
    if config.start == "centroid":
        return np.asarray(shift_m)
    groups = sample_groups(
        points_m, np.zeros(len(points_m), np.int64), total=1, max_points=config.vote.max_points
    )
    center_m = groups.center_m + shift_m
    poses = start_hypotheses(
        groups, np.arange(1), np.ones(1, bool), near_m, center_m, max_shift_m, config.vote
    )
    distance_m = mean_nearest_m(groups, build_tree(near_m), poses, NO_PARTNER_M)
    return np.asarray(poses.center_m[int(distance_m.argmin())] - groups.center_m[0])


def _prune(points_m: Floats, near_m: Floats, start_m: Floats) -> Floats:
    """Return the points nearest to where the start takes the component's mean: fewer than either set has."""
    kept = min(len(points_m), len(near_m)) - 1
    distance_m = np.linalg.norm(near_m - points_m.mean(axis=0) - start_m, axis=1)
    return near_m[np.sort(np.argsort(distance_m, kind="stable")[: max(kept, 0)])]
