"""Vote, ICP and the choice between hypotheses of flow: by construction, by hand, and against a dense solver."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.flow.config import FlowVoteConfig, RigidFlowConfig
from upvl_cli.perception.flow.displacement_vote import mean_nearest_m, select_starts, start_hypotheses
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses, sample_groups, static_poses
from upvl_cli.perception.flow.icp import _step, icp
from upvl_cli.perception.flow.search import FlowState, Found, Labelled, TargetPoints, _cost, search_poses
from upvl_cli.perception.flow.surface import LocalSurface, build_tree, estimate_surface
from upvl_cli.stages.flow import FlowConfig

CONFIG = load(FlowConfig, Path(__file__).parents[3] / "stages" / "flow.toml").rigid


def one_group(xyz_m: np.ndarray) -> Groups:
    return sample_groups(xyz_m, np.zeros(len(xyz_m), np.int64), total=1, max_points=10**6)


def surface_of(xyz_m: np.ndarray) -> LocalSurface:
    return estimate_surface(one_group(xyz_m), build_tree(xyz_m), CONFIG.surface)


def moved(groups: Groups, x_m: float, y_m: float, z_m: float, yaw_rad: float = 0.0) -> Poses:
    rest = static_poses(groups)
    return Poses(rest.group, rest.yaw_rad + yaw_rad, rest.center_m + (x_m, y_m, z_m))


def box(seed: int = 0, count: int = 200) -> np.ndarray:
    """Random points on three sides of a box of 2 m x 1 m x 1 m."""
    rng = np.random.default_rng(seed)
    faces = rng.uniform(0, 1, (3, count, 3))
    for axis in range(3):
        faces[axis, :, axis] = 0
    return faces.reshape(-1, 3) * (2, 1, 1)


def starts_of(
    groups: Groups, target_m: np.ndarray, center_m: np.ndarray, max_shift_m: float, vote: FlowVoteConfig
) -> Poses:
    """The starts of all groups, each with a vote."""
    every = np.arange(len(groups.size))
    return start_hypotheses(groups, every, every >= 0, target_m, center_m, max_shift_m, vote)


NONE_M = np.full((1, 3), np.nan)


def test_starts_are_rest_then_the_shift_of_the_center_then_the_vote() -> None:
    xyz_m = box()
    target_m = xyz_m + (1.6, -0.7, 0.1)
    groups = one_group(xyz_m)
    found = starts_of(groups, target_m, groups.center_m + (0.4, 0.5, 9.0), 3.0, CONFIG.vote)
    shift_m = found.center_m - groups.center_m
    np.testing.assert_allclose(shift_m[0], 0)
    np.testing.assert_allclose(shift_m[1], [0.4, 0.5, 0], atol=1e-9)
    np.testing.assert_allclose(shift_m[2], [1.65, -0.75, 0], atol=1e-9)  # the middle of its cell of 0.3 m
    assert len(shift_m) == 5
    without_center = starts_of(groups, target_m, NONE_M, 3.0, CONFIG.vote)
    np.testing.assert_allclose(without_center.center_m, found.center_m[[0, 2, 3, 4]])
    few = starts_of(groups, target_m, NONE_M, 3.0, replace(CONFIG.vote, peaks=1))
    assert len(few.group) == 2


def test_the_vote_counts_pairs_in_a_plain_histogram() -> None:
    rng = np.random.default_rng(0)
    source_m, target_m = rng.uniform(-2, 2, (40, 3)), rng.uniform(-2, 2, (70, 3))
    groups = one_group(source_m)
    found = starts_of(groups, target_m, NONE_M, 1.7, replace(CONFIG.vote, peaks=400))
    shift_m = (target_m[:, None] - source_m).reshape(-1, 3)
    votes = shift_m[(np.abs(shift_m[:, 2]) < 0.2) & (np.hypot(*shift_m.T[:2]) <= 1.7), :2]
    cells, counts = np.unique(np.floor(votes / 0.3), axis=0, return_counts=True)
    order = np.lexsort((cells[:, 1], cells[:, 0], -counts))
    found_m = (found.center_m - groups.center_m)[1:, :2]
    np.testing.assert_allclose(found_m, (cells[order] + 0.5) * 0.3, atol=1e-9)


@pytest.mark.parametrize(("rise_m", "votes"), [(0.15, True), (0.25, False), (-0.15, True), (-0.25, False)])
def test_pairs_of_other_heights_do_not_vote(rise_m: float, votes: bool) -> None:
    source_m = np.array([[5.0, 5, 1]])
    found = starts_of(one_group(source_m), source_m + (1, 1, rise_m), NONE_M, 3.0, CONFIG.vote)
    assert len(found.group) == (2 if votes else 1)


@pytest.mark.parametrize(("shift_m", "votes"), [(1.9, True), (2.1, False)])
def test_pairs_beyond_the_longest_motion_do_not_vote(shift_m: float, votes: bool) -> None:
    source_m = np.array([[5.0, 5, 1]])
    for way in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.7071, 0.7071, 0)):
        target_m = source_m + shift_m * np.array(way)
        found = starts_of(one_group(source_m), target_m, NONE_M, 2.0, CONFIG.vote)
        assert len(found.group) == (2 if votes else 1)


def test_a_large_target_is_thinned_to_the_number_of_voters() -> None:
    source_m = np.zeros((1, 3))
    target_m = np.concatenate([[[1.0, 0, 0], [0, 1.0, 0]]] * 40)  # every second one is the same
    thinned = starts_of(one_group(source_m), target_m, NONE_M, 2.0, replace(CONFIG.vote, max_points=40))
    assert len(thinned.group) == 2
    assert len(starts_of(one_group(source_m), target_m, NONE_M, 2.0, CONFIG.vote).group) == 3


def test_rest_and_the_nearest_of_the_others_are_followed() -> None:
    """Of two groups, the second at its best as it is; the order of hypotheses is kept."""
    xyz_m = np.concatenate([box(), box(1) + (0, 30, 0)])
    groups = sample_groups(xyz_m, np.repeat([0, 1], 600), total=2, max_points=50)
    tree = build_tree(xyz_m + (1, 0, 0))
    x_m = np.array([9.0, 0.7, 3.0, 1.1, 0.9, 5.0, 1.3])
    group = np.array([0, 0, 0, 0, 1, 1, 1])
    shift_m = np.stack([x_m, 0 * x_m, 0 * x_m], axis=1)
    hypotheses = Poses(group, 0 * x_m, groups.center_m[group] + shift_m)
    found = select_starts(groups, tree, hypotheses, 2, 0.5)
    np.testing.assert_allclose((found.center_m - groups.center_m[found.group])[:, 0], [9, 0.7, 1.1, 0.9])
    found = select_starts(groups, tree, hypotheses, 1, 0.5)
    np.testing.assert_allclose((found.center_m - groups.center_m[found.group])[:, 0], [9, 1.1, 0.9])


def test_a_point_without_partner_counts_as_one_at_the_cut_off() -> None:
    groups = one_group(np.array([[0.0, 0, 0], [10, 0, 0]]))
    tree = build_tree(np.array([[0.0, 0.1, 0]]))
    assert mean_nearest_m(groups, tree, static_poses(groups), 0.5)[0] == pytest.approx((0.1 + 0.5) / 2)
    assert mean_nearest_m(groups, tree, static_poses(groups), 20.0)[0] == pytest.approx(
        (0.1 + np.hypot(10, 0.1)) / 2
    )


def test_a_step_is_that_of_a_dense_least_squares_solver() -> None:
    """Each pair pulls by 1 across a flat patch and by 0.02 along it; each pair holds the height by 0.1."""
    rng = np.random.default_rng(0)
    source = np.concatenate([box(), rng.normal(0, 0.4, (60, 3)) + (1, 1, 1)])
    surface = surface_of(source)
    assert surface.is_flat.any() and not surface.is_flat.all()
    tree = build_tree(source + rng.normal(0, 0.05, source.shape) + (0.1, 0.2, 0.15))
    pose = moved(surface.groups, 0.03, 0.1, 0.08, yaw_rad=0.4)
    solved, turn, shift = _step(surface, tree, pose, (0.3, 0.3), CONFIG.icp)
    assert solved.tolist() == [0]
    _, point, xyz_m = apply_poses(surface.groups, pose)
    distance, partner = tree.query(xyz_m, distance_upper_bound=0.3)
    cos, sin = np.cos(0.4), np.sin(0.4)
    matrix, right, pairs = np.zeros((4, 4)), np.zeros(4), 0
    for k, place_m, d, other in zip(point, xyz_m, distance, partner, strict=True):
        if not np.isfinite(d):
            continue
        pairs += 1
        arm = place_m - pose.center_m[0]
        jacobian = np.column_stack([[-arm[1], arm[0], 0], np.eye(3)])
        normal = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ surface.normal[k]
        weight = 0.02 * np.eye(3) + 0.98 * np.outer(normal, normal) if surface.is_flat[k] else np.eye(3)
        matrix += jacobian.T @ weight @ jacobian
        right += jacobian.T @ weight @ (tree.data[other] - place_m)
    assert pairs < len(source)
    matrix[3, 3] += 0.1 * pairs
    right[3] -= 0.1 * pairs * 0.08
    np.testing.assert_allclose(np.append(turn, shift), np.linalg.solve(matrix, right), rtol=1e-3, atol=1e-6)


def test_icp_finds_a_known_motion() -> None:
    points = box()
    center = points.mean(axis=0)
    cos, sin = np.cos(0.1), np.sin(0.1)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    target = (points - center) @ turn.T + center + (0.3, 0.2, 0.0)
    surface = surface_of(points)
    found = icp(
        surface, build_tree(target), static_poses(surface.groups), (1.0,) * 20 + (0.2,) * 10, CONFIG.icp
    )
    np.testing.assert_allclose(found.center_m - surface.groups.center_m, [[0.3, 0.2, 0]], atol=0.01)
    np.testing.assert_allclose(found.yaw_rad, 0.1, atol=0.01)


def lattice() -> np.ndarray:
    """Points 2 m apart in all directions: no pair can be mistaken for another, and nothing is flat."""
    return 2.0 * np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3)


def test_a_narrower_radius_leaves_out_what_a_wide_one_has_drawn() -> None:
    """A quarter of the points is 0.8 m off: with all pairs the mean pull ends at 0.2 m, where it rests."""
    points = lattice()
    config = replace(CONFIG.icp, radius_spacings=0.0)
    target = points.copy()
    target[::4, 0] += 0.8
    surface = surface_of(points)
    start = static_poses(surface.groups)
    wide = icp(surface, build_tree(target), start, (0.9,) * 6, config)
    np.testing.assert_allclose(wide.center_m - start.center_m, [[0.2, 0, 0]], atol=0.02)
    narrowed = icp(surface, build_tree(target), start, (0.9,) * 6 + (0.3,) * 3, config)
    np.testing.assert_allclose(narrowed.center_m - start.center_m, [[0, 0, 0]], atol=0.01)


@pytest.mark.parametrize(
    ("spacings", "widest_m", "pairs"), [(0.0, 0.3, False), (1.5, 0.3, True), (1.5, 0.1, False)]
)
def test_where_points_lie_far_apart_the_radius_stays_wide(
    spacings: float, widest_m: float, pairs: bool
) -> None:
    """Points 2 m apart, 0.25 m off, and a radius of 0.1 m; the first radius of a pass bounds it."""
    points = lattice()
    surface = surface_of(points)
    config = replace(CONFIG.icp, radius_spacings=spacings)
    tree = build_tree(points + (0.25, 0, 0))
    solved, _, _ = _step(surface, tree, static_poses(surface.groups), (0.1, widest_m), config)
    assert (len(solved) == 1) == pairs


def test_icp_goes_on_until_its_steps_are_small() -> None:
    """Dense points step by step: the first steps are short of the way."""
    points = box()
    surface = surface_of(points)
    start = static_poses(surface.groups)
    tree = build_tree(points + (0.25, 0.15, 0))
    found = icp(surface, tree, start, (0.5,) * 40, CONFIG.icp)
    np.testing.assert_allclose(found.center_m - start.center_m, [[0.25, 0.15, 0]], atol=0.01)
    one_step = icp(surface, tree, start, (0.5,), CONFIG.icp)
    assert np.abs(one_step.center_m - found.center_m).max() > 0.02


def test_what_no_pair_fixes_stays_as_it_is() -> None:
    """A line of points one above the other can turn as it likes."""
    line = np.stack([np.full(30, 5.0), np.full(30, 1.0), np.linspace(0, 2, 30)], axis=1)
    surface = surface_of(line)
    found = icp(surface, build_tree(line + (0.1, 0, 0)), static_poses(surface.groups), (0.5, 0.5), CONFIG.icp)
    np.testing.assert_allclose(found.yaw_rad, 0, atol=1e-6)
    np.testing.assert_allclose(found.center_m - surface.groups.center_m, [[0.1, 0, 0]], atol=0.01)


def test_only_hypotheses_with_enough_pairs_step() -> None:
    """Of three groups the middle one has no partner: the others move, each by its own way."""
    points = np.concatenate([lattice() + (0, 30 * k, 0) for k in range(3)])
    groups = sample_groups(points, np.repeat([0, 1, 2], 64), total=3, max_points=99)
    surface = estimate_surface(groups, build_tree(points), CONFIG.surface)
    target = np.concatenate([points[:64] + (0.2, 0, 0), points[128:] + (0, -0.3, 0)])
    found = icp(surface, build_tree(target), static_poses(groups), (0.6, 0.6), CONFIG.icp)
    expected = [[0.2, 0, 0], [0, 0, 0], [0, -0.3, 0]]
    np.testing.assert_allclose(found.center_m - groups.center_m, expected, atol=1e-3)


@pytest.mark.parametrize(("count", "is_solved"), [(7, False), (8, True)])
def test_a_motion_needs_eight_pairs(count: int, is_solved: bool) -> None:
    points = box()[:: 600 // count][:count]
    surface = surface_of(points)
    start = static_poses(surface.groups)
    found = icp(surface, build_tree(points + (0.1, 0, 0)), start, CONFIG.icp.fine_radii_m, CONFIG.icp)
    assert (np.abs(found.center_m - start.center_m).max() > 0.05) == is_solved


def state_of(source_m: np.ndarray, target_m: np.ndarray, max_shift_m: float = 3.0) -> FlowState:
    return FlowState.at_rest(source_m, target_m, max_shift_m, CONFIG.surface)


def found_in(state: FlowState, config: RigidFlowConfig, near: np.ndarray | None = None) -> Found:
    """What the search finds for all points as one group that stands nowhere."""
    labelled = Labelled(np.arange(len(state.source_m)), np.zeros(len(state.source_m), np.int64))
    target = TargetPoints(state.target_m, np.full(len(state.target_m), -1) if near is None else near)
    return search_poses(state, labelled, target, np.zeros(1), np.full(1, 1e9), config)


def shift_m_of(found: Found) -> np.ndarray:
    """The shift of the one group."""
    return (found.poses.center_m - found.points.groups.center_m)[0]


def search(state: FlowState, **plausibility: float) -> tuple[np.ndarray, float]:
    """The shift of one group, and its cost."""
    found = found_in(state, replace(CONFIG, plausibility=replace(CONFIG.plausibility, **plausibility)))
    return shift_m_of(found), float(found.cost[0])


def test_the_search_finds_a_far_motion_and_its_cost_grows_with_its_length() -> None:
    state = state_of(box(), box(1) + (2.0, 1.0, 0))
    shift_m, cost = search(state)
    np.testing.assert_allclose(shift_m, [2, 1, 0], atol=0.05)
    assert cost - search(state, misfit_per_m=0.0)[1] == pytest.approx(0.1 * np.linalg.norm(shift_m), abs=1e-6)


def test_the_fine_pass_makes_the_motion_exact() -> None:
    """After a single coarse step with few points the pose is centimetres off."""
    state = state_of(box(), box() + (2.0, 1.0, 0))
    off_m = []
    for fine_radii_m in ((), CONFIG.icp.fine_radii_m):
        coarse = replace(CONFIG.icp, coarse_radii_m=(1.0,), coarse_points=20, fine_radii_m=fine_radii_m)
        found = found_in(state, replace(CONFIG, icp=replace(coarse, stretch=(1.0,))))
        off_m.append(np.linalg.norm(shift_m_of(found) - (2, 1, 0)))
    assert off_m[1] < 0.005 < 0.02 < off_m[0], off_m


@pytest.mark.parametrize(("starts", "is_found"), [(0, False), (1, True)])
def test_only_the_selected_starts_are_followed(starts: int, is_found: bool) -> None:
    state = state_of(box(), box(1) + (2.0, 1.0, 0))
    found = found_in(state, replace(CONFIG, vote=replace(CONFIG.vote, starts=starts)))
    assert np.allclose(shift_m_of(found), (2, 1, 0), atol=0.05) == is_found


def test_of_two_places_that_fit_alike_the_nearer_is_taken() -> None:
    state = state_of(box(), np.concatenate([box(1) + (-1.5, 2, 0), box(1) + (1, 1, 0)]))
    np.testing.assert_allclose(search(state)[0], [1, 1, 0], atol=0.05)


@pytest.mark.parametrize(("max_shift_m", "expected_m"), [(2.4, (0, -2, 0)), (2.6, (2.5, 0, 0))])
def test_a_motion_is_no_longer_than_the_fastest(max_shift_m: float, expected_m: tuple[float, ...]) -> None:
    """The farther place fits exactly, and its center is a start."""
    target = np.concatenate([box() + (2.5, 0, 0), box(1) + (0, -2, 0)])
    state = state_of(box(), target, max_shift_m)
    near = np.repeat([0, -1], 600)
    config = replace(CONFIG, plausibility=replace(CONFIG.plausibility, misfit_per_m=0.0))
    np.testing.assert_allclose(shift_m_of(found_in(state, config, near)), expected_m, atol=0.05)


@pytest.mark.parametrize(
    ("way_m", "is_possible"),
    [
        ((0, 0, 0.09), True),
        ((0, 0, 0.11), False),
        ((0.6, 0.8, 0.29), True),
        ((0.6, 0.8, 0.31), False),
        ((0.6, 0.8, -0.31), False),
    ],
    ids=str,
)
def test_what_stands_on_the_ground_rises_no_more_than_a_slope(
    way_m: tuple[float, ...], is_possible: bool
) -> None:
    """0.1 m and a fifth of the way; what fits exactly costs its length alone."""
    ball = np.random.default_rng(0).normal(0, 0.5, (200, 3))
    surface = surface_of(ball)
    cost = _cost(surface, build_tree(ball + way_m), moved(surface.groups, *way_m), CONFIG.plausibility)
    assert cost[0] == (pytest.approx(0.1 * np.linalg.norm(way_m)) if is_possible else np.inf)


@pytest.mark.parametrize(("share", "is_hidden"), [(0.2, True), (0.0, False)])
def test_a_wall_that_slides_along_itself_shows_no_motion(share: float, is_hidden: bool) -> None:
    x, z = (axis.ravel() for axis in np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 2, 0.1)))
    wall = np.stack([x, 0 * x, z], axis=1)
    config = replace(CONFIG, plausibility=replace(CONFIG.plausibility, min_observable_share=share))
    found = found_in(state_of(wall, wall + (0.6, 0, 0)), config)
    assert found.is_hidden.tolist() == [is_hidden]


@pytest.mark.parametrize(("share", "count"), [(0.3, 1), (0.0, 0)])
def test_a_pose_of_too_high_a_cost_is_not_found(share: float, count: int) -> None:
    state = state_of(box(), box(1) + (2.0, 1.0, 0))
    labelled = Labelled(np.arange(600), np.zeros(600, np.int64))
    target = TargetPoints(state.target_m, np.full(600, -1))
    assert len(search_poses(state, labelled, target, np.zeros(1), np.full(1, share), CONFIG).group) == count


def test_what_lies_on_the_other_sweep_is_not_searched() -> None:
    state = state_of(box(), box(1) + (2.0, 1.0, 0))
    labelled = Labelled(np.arange(600), np.zeros(600, np.int64))
    target = TargetPoints(state.target_m, np.full(600, -1))
    assert len(search_poses(state, labelled, target, np.full(1, 5.0), np.full(1, 1e9), CONFIG).group) == 0


def test_a_shift_that_long_sides_hold_back_is_stretched() -> None:
    """Of a long truck, 120 points of its side for each of its rear; one coarse step goes part of the way."""
    rng = np.random.default_rng(0)

    def truck(x_m: float) -> np.ndarray:
        side = rng.uniform((0, 0, 0), (10, 0, 2), (3000, 3))
        return np.concatenate([side, rng.uniform((0, 0, 0), (0, 2, 2), (60, 3))]) + (x_m, 0, 0)

    state = state_of(truck(0), truck(0.8))
    config = replace(CONFIG, icp=replace(CONFIG.icp, coarse_radii_m=(1.0, 1.0), fine_radii_m=()))
    config = replace(config, vote=replace(config.vote, starts=0))
    short = replace(config, icp=replace(config.icp, stretch=(1.0,)))
    stretched_m, short_m = (abs(shift_m_of(found_in(state, each))[0] - 0.8) for each in (config, short))
    assert stretched_m < short_m


def test_points_move_with_their_group_alone() -> None:
    """A quarter turn about the center of the chosen group; the mean pose comes back from the points."""
    source_m = np.array([[0.0, 0, 0], [2, 0, 0], [5, 5, 5], [9, 9, 9]])
    state = state_of(source_m, source_m)
    point, group = np.arange(4), np.array([0, 0, 1, -1])
    groups = sample_groups(source_m, group, total=2, max_points=9)
    pose = Poses(np.arange(2), np.array([np.pi / 2, 0.3]), groups.center_m + (1, 0, 0))
    state.move(Labelled(point, group), np.array([0]), groups, pose[np.array([0])])
    np.testing.assert_allclose(
        source_m + state.shift_m, [[2, -1, 0], [2, 1, 0], [5, 5, 5], [9, 9, 9]], atol=1e-12
    )
    np.testing.assert_allclose(state.yaw_rad, [np.pi / 2, np.pi / 2, 0, 0])
    found = state.poses(Labelled(point[:3], group[:3]), groups)
    np.testing.assert_allclose(found.center_m, groups.center_m + [[1, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(found.yaw_rad, [np.pi / 2, 0])
