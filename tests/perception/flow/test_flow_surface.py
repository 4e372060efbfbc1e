"""Misfit, surfaces and groups of flow: against plain loops, and by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.flow.groups import (
    Groups,
    Poses,
    apply_poses,
    group_means,
    relabel,
    sample_groups,
    static_poses,
)
from upvl_cli.perception.flow.surface import build_tree, estimate_surface, misfit, observable_share
from upvl_cli.stages.flow import FlowConfig

CONFIG = load(FlowConfig, Path(__file__).parents[3] / "stages" / "flow.toml").rigid.surface


def one_group(xyz_m: np.ndarray) -> Groups:
    return sample_groups(xyz_m, np.zeros(len(xyz_m), np.int64), total=1, max_points=10**6)


def poses(*rows: tuple[int, float, float, float, float]) -> Poses:
    group, yaw_rad, *center_m = np.array(rows).T
    return Poses(group.astype(np.int64), yaw_rad, np.stack(center_m, axis=1))


def grid(spacing_m: float, half_m: float = 1.5, turn: np.ndarray | None = None) -> np.ndarray:
    """A square net of points in the plane x, z through the origin."""
    at = np.arange(-half_m, half_m + 1e-9, spacing_m)
    x, z = (axis.ravel() for axis in np.meshgrid(at, at))
    points = np.stack([x, 0 * x, z], axis=1)
    return points if turn is None else points @ turn.T


def test_a_sample_takes_every_kth_point_of_each_group() -> None:
    group = np.array([1, 0, 1, -1, 1, 0, 1, 1, 1])
    xyz_m = np.arange(27.0).reshape(9, 3)
    found = sample_groups(xyz_m, group, total=3, max_points=3)
    assert found.xyz_m[:, 0].tolist() == [3, 15, 0, 12, 21]
    assert (found.first.tolist(), found.size.tolist()) == ([0, 2, 5], [2, 3, 0])
    np.testing.assert_allclose(found.center_m[1], xyz_m[group == 1].mean(axis=0))
    assert np.isnan(found.center_m[2]).all()


@pytest.mark.parametrize("size", [1, 2, 5, 7, 31, 32, 33, 100])
@pytest.mark.parametrize("max_points", [1, 2, 5, 32])
def test_a_sample_is_even(size: int, max_points: int) -> None:
    xyz_m = np.arange(size)[:, None] * np.ones(3)
    found = sample_groups(xyz_m, np.zeros(size, np.int64), total=1, max_points=max_points).xyz_m[:, 0]
    assert len(found) == min(size, max_points)
    assert found[0] == 0
    gaps = np.diff(found, append=size)
    assert gaps.max() - gaps.min() <= 1


def test_means_leave_out_what_has_no_group() -> None:
    values = np.array([[1.0, 10], [3, 30], [100, 100]])
    found = group_means(values, np.array([1, 1, -1]), 2)
    assert np.isnan(found[0]).all()
    assert found[1].tolist() == [2, 20]


def test_labels_become_their_index() -> None:
    assert relabel(np.array([7, -1, 3, 9, 5]), np.array([3, 7])).tolist() == [1, -1, 0, -1, -1]
    assert relabel(np.array([7, 3]), np.array([], dtype=np.int64)).tolist() == [-1, -1]


def test_poses_turn_groups_about_their_own_center() -> None:
    """A quarter turn counter-clockwise; the second hypothesis is about the first group again."""
    xyz_m = np.array([[1.0, 0, 0], [3, 0, 1], [10, 10, 10]])
    groups = sample_groups(xyz_m, np.array([0, 0, 1]), total=2, max_points=9)
    item, point, moved_m = apply_poses(groups, poses((1, 0.0, 0, 0, 0), (0, np.pi / 2, 5, 5, 5)))
    assert (item.tolist(), point.tolist()) == ([0, 1, 1], [2, 0, 1])
    np.testing.assert_allclose(moved_m, [[0, 0, 0], [5, 4, 4.5], [5, 6, 5.5]], atol=1e-12)
    at_rest = apply_poses(groups, static_poses(groups))[2]
    np.testing.assert_allclose(at_rest, xyz_m)


def test_spacing_is_the_expected_distance_to_another_sample_of_the_surface() -> None:
    rng = np.random.default_rng(0)
    first, second = (np.stack([*rng.uniform(-10, 10, (2, 8000)), np.zeros(8000)], axis=1) for _ in range(2))
    inner = first[np.abs(first).max(axis=1) < 9]
    found = estimate_surface(one_group(inner), build_tree(first), CONFIG)
    nearest_m = build_tree(second).query(inner)[0]
    assert found.spacing_m.mean() == pytest.approx(nearest_m.mean(), rel=0.05)


def test_spacing_by_hand() -> None:
    """Eight neighbors of a net of 0.2 m reach to its diagonal."""
    net = grid(0.2)
    found = estimate_surface(one_group(net), build_tree(net), CONFIG)
    middle = np.linalg.norm(net, axis=1).argmin()
    assert found.spacing_m[middle] == pytest.approx(0.5 * np.sqrt(np.pi / 8) * 0.2 * np.sqrt(2))


def test_neighbors_beyond_the_radius_are_left_out() -> None:
    """Seven near ones and one too far: the width is the radius, and the far one does not tilt the plane."""
    near = np.array([[x, 0.0, z] for x in (0, 1, 2, 3) for z in (0, 1)]) * 0.1
    cloud = np.concatenate([near, [[0.1, 4.0, 0]]])
    found = estimate_surface(one_group(near), build_tree(cloud), CONFIG)
    np.testing.assert_allclose(found.spacing_m, 0.5 * np.sqrt(np.pi / 8) * 3.0)
    assert found.is_flat.all()
    np.testing.assert_allclose(np.abs(found.normal), np.tile([0.0, 1, 0], (8, 1)), atol=1e-9)


def test_normals_are_those_of_the_eigenvectors() -> None:
    rng = np.random.default_rng(1)
    cloud = rng.normal(0, 1, (300, 3)) * (1, 1, 0.08)
    tree = build_tree(cloud)
    found = estimate_surface(one_group(cloud), tree, CONFIG)
    flat = 0
    for at in range(300):
        distance, near = tree.query(cloud[at], k=9, distance_upper_bound=3.0)
        near = np.where(np.isfinite(distance), near, at)
        value, vector = np.linalg.eigh(np.cov(cloud[near].T, bias=True))
        assert found.is_flat[at] == (value[0] < 0.1 * value[1])
        if found.is_flat[at]:
            flat += 1
            assert abs(found.normal[at] @ vector[:, 0]) == pytest.approx(1, abs=1e-5)
    assert 30 < flat < 270


def test_points_in_one_place_are_not_flat() -> None:
    cloud = np.ones((12, 3))
    assert not estimate_surface(one_group(cloud), build_tree(cloud), CONFIG).is_flat.any()


def test_misfit_is_that_of_a_plain_loop() -> None:
    """Flat and round groups, turned and shifted, with partners near, far and none."""
    rng = np.random.default_rng(2)
    wall, bush = grid(0.25), rng.normal(0, 0.3, (60, 3)) + (6, 0, 0)
    source = np.concatenate([wall, bush])
    group = np.repeat([0, 1], [len(wall), len(bush)])
    target = source + rng.normal(0, 0.05, source.shape)
    target[::7] += (0, 0, 20)
    surface = estimate_surface(
        sample_groups(source, group, total=2, max_points=1000), build_tree(source), CONFIG
    )
    assert surface.is_flat[: len(wall)].all() and not surface.is_flat[len(wall) :].all()
    hypotheses = poses((0, 0.3, 0.1, 0.2, 0), (1, -1.0, 6.2, 0, 0.1), (0, 0, 0, 0.45, 0), (1, 0, 9, 0, 0))
    found = misfit(surface, build_tree(target), hypotheses)
    for number in range(4):
        off = []
        item, point, xyz_m = apply_poses(surface.groups, hypotheses[np.array([number])])
        yaw = hypotheses.yaw_rad[number]
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        for k, place_m in zip(point, xyz_m, strict=True):
            residual_m = target - place_m
            residual_m = residual_m[np.linalg.norm(residual_m, axis=1).argmin()]
            distance_m = np.linalg.norm(residual_m)
            if distance_m >= 0.5:
                off_m = 0.5
            elif surface.is_flat[k]:
                across_m = residual_m @ (turn @ surface.normal[k])
                along_m = np.linalg.norm(residual_m - across_m * (turn @ surface.normal[k]))
                off_m = min(np.hypot(across_m, max(along_m - 2 * surface.spacing_m[k], 0)), 0.5)
            else:
                off_m = distance_m
            off.append(min(off_m / (surface.spacing_m[k] + 0.025), 5.0))
        assert found[number] == pytest.approx(np.mean(off), rel=1e-9)


def test_a_dense_surface_far_off_counts_five_spacings_and_no_more() -> None:
    net = grid(0.02, half_m=0.2)
    surface = estimate_surface(one_group(net), build_tree(net), CONFIG)
    far = build_tree(net + (0, 5, 0))
    assert misfit(surface, far, static_poses(surface.groups)) == pytest.approx(5.0)
    looser = surface._replace(config=replace(CONFIG, max_misfit=8.0))
    assert misfit(looser, far, static_poses(surface.groups))[0] > 6


@pytest.mark.parametrize(
    ("shift_m", "is_observable"),
    [
        ((1.0, 0, 0), False),
        ((0, 0.3, 0), True),
        ((1.0, 0.21, 0), False),
        ((1.0, 0.25, 0), True),
        ((0, 0.02, 0), False),
    ],
    ids=str,
)
def test_a_plane_shows_motion_across_it_alone(shift_m: tuple[float, ...], is_observable: bool) -> None:
    """By more than 2.5 cm of noise and 0.2 of its length."""
    net = grid(0.2)
    surface = estimate_surface(one_group(net), build_tree(net), CONFIG)
    assert observable_share(surface, poses((0, 0.0, *shift_m)))[0] == is_observable


def test_round_things_show_every_motion() -> None:
    ball = np.random.default_rng(0).normal(0, 1, (100, 3))
    surface = estimate_surface(one_group(ball), build_tree(ball), CONFIG)
    moved = static_poses(surface.groups)
    moved = Poses(moved.group, moved.yaw_rad, moved.center_m + (1, 0, 0))
    expected = np.mean(~surface.is_flat | (np.abs(surface.normal[:, 0]) > 0.225))
    assert observable_share(surface, moved)[0] == pytest.approx(expected)
    assert 0 < np.mean(surface.is_flat) < 1
