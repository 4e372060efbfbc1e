"""First and second pass of flow: which components move, who keeps a place, and parts with a motion of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.groups import Poses, sample_groups
from upvl_cli.perception.flow.residual import residual_mask
from upvl_cli.perception.flow.rigid import estimate_rigid_flow, occupies_most_cells
from upvl_cli.perception.flow.surface import build_tree
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.stages.flow import FlowConfig

CONFIG = load(FlowConfig, Path(__file__).parents[3] / "stages" / "flow.toml").rigid
FIRST_PASS = replace(CONFIG, residual=replace(CONFIG.residual, min_points=10**6))
DT_S = 0.1


def flow_mps(source: np.ndarray, target: np.ndarray, config: RigidFlowConfig = CONFIG) -> np.ndarray:
    return estimate_rigid_flow(source, [OtherSweep(target, DT_S)], config)


def panel(corner: tuple[float, ...], *edges: tuple[float, ...], count: int, seed: int) -> np.ndarray:
    """Random points of the parallelogram that two edges span, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (count, 2)) @ np.array(edges) + corner + rng.normal(0, 0.01, (count, 3))


def car(x_m: float, y_m: float, seed: int) -> np.ndarray:
    """Side and rear of a car about a place."""
    side = panel((-2, -0.9, 0.3), (4, 0, 0), (0, 0, 1.2), count=300, seed=seed)
    rear = panel((-2, -0.9, 0.3), (0, 1.8, 0), (0, 0, 1.2), count=150, seed=seed + 1000)
    return np.concatenate([side, rear]) + (x_m, y_m, 0)


def walker(x_m: float, y_m: float, seed: int, count: int = 150) -> np.ndarray:
    """The near half of a man 1.7 m tall and 0.5 m wide."""
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(np.pi / 2, 3 * np.pi / 2, count), rng.uniform(0.3, 1.7, count)
    return np.stack([x_m + 0.25 * np.cos(angle), y_m + 0.25 * np.sin(angle), z], axis=1)


def cells(*rows: tuple[tuple[int, ...], float, float]) -> tuple:
    """Groups of one point a cell of 1 m: the cells along x, then shift and gain; as arguments."""
    points = [np.array([[x + 0.5, 0.5, 0.5] for x in xs]) for xs, _, _ in rows]
    group = np.repeat(np.arange(len(rows)), [len(xs) for xs in points])
    groups = sample_groups(np.concatenate(points), group, total=len(rows), max_points=99)
    shift_m = np.array([[shift, 0, 0] for _, shift, _ in rows], dtype=float)
    poses = Poses(np.arange(len(rows)), np.zeros(len(rows)), groups.center_m + shift_m)
    return groups, poses, np.array([gain for _, _, gain in rows], dtype=float), 1.0


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([((0, 1, 2, 3), 10, 5), ((30, 31, 32, 33), -20, 4)], [True, False]),
        ([((0, 1, 2, 3), 10, 4), ((30, 31, 32, 33), -20, 5)], [False, True]),
        ([((0, 1, 2, 3), 10, 5), ((32, 33, 34, 35), -20, 4)], [True, True]),
        ([((0, 1, 2, 3), 10, 5), ((31, 32, 33, 34), -20, 4)], [True, False]),
        ([((0, 1, 2, 3), 10, 5), ((0, 1, 2, 3), 50, 4)], [True, True]),
        ([((0, 1, 2, 3), 10, 4), ((30, 31, 32, 33), -20, 4)], [True, True]),
        ([((0, 1, 2, 3), 10, 5), ((30, 31), -20, 6), ((42, 43), -30, 6)], [False, True, True]),
    ],
    ids=[
        "the larger gain keeps the place",
        "whichever comes first",
        "half of the cells are enough",
        "a quarter is not",
        "other places do not matter",
        "equal gains both keep it",
        "two others can take a place",
    ],
)
def test_two_objects_cannot_move_to_one_place(rows: list, expected: list[bool]) -> None:
    assert occupies_most_cells(*cells(*rows)).tolist() == expected


def test_a_cell_counts_once_however_many_points_lie_in_it() -> None:
    groups, poses, gain, edge_m = cells(((0, 0, 0, 0, 0, 1, 2), 10, 4), ((30,), -20, 9))
    assert occupies_most_cells(groups, poses, gain, edge_m).tolist() == [True, True]


def test_of_two_objects_that_seem_to_become_one_only_the_likelier_moves() -> None:
    """Two walkers, of whom one has vanished: the nearer of the two went to where there is one."""
    source = np.concatenate([walker(10, 0, 0), walker(10, 2.5, 1)])
    target = walker(10, 1.0, 2)
    found = flow_mps(source, target)
    np.testing.assert_allclose(found[:150].mean(axis=0), [0, 10, 0], atol=0.7)
    assert np.abs(found[150:]).max() == 0
    both = flow_mps(source, target, replace(CONFIG, occupancy_cell_m=0.05))
    assert np.linalg.norm(both[150:], axis=1).min() > 5, "without cells in common both would"


def test_the_object_with_more_points_keeps_a_place_though_each_explains_less() -> None:
    """A child fits exactly, 1 m away; a man, 1.3 m away, has more points that fit."""
    child, man = walker(10, 0, 0) * (1, 1, 0.6), walker(10, 2.3, 1)
    target = np.concatenate([child + (0, 1, 0), walker(10, 1, 2)])
    found = flow_mps(np.concatenate([child[::2], man]), target)
    assert np.abs(found[:75]).max() == 0
    np.testing.assert_allclose(found[75:].mean(axis=0), [0, -13, 0], atol=1)
    alone = flow_mps(child[::2], target)
    np.testing.assert_allclose(alone.mean(axis=0), [0, 10, 0], atol=1)


@pytest.mark.parametrize(("count", "moves"), [(7, False), (8, True)])
def test_seven_points_have_no_motion_though_a_start_fits(count: int, moves: bool) -> None:
    """Too few for ICP, and so for any motion: the start in the middle of a cell of the vote fits exactly."""
    body, post = walker(10, 0, 0, 12), walker(11.2, -1, 1)
    source = np.concatenate([body[:count], post])
    found = flow_mps(source, np.concatenate([body + (0.45, 0.45, 0), post]))
    assert (np.abs(found).max() > 0) == moves


@pytest.mark.parametrize("seed", [0, 1], ids=["the same points of it", "others"])
def test_nothing_moves_to_where_a_static_object_stands(seed: int) -> None:
    """A walker vanishes; a post of his shape, 1.5 m away, stands in both sweeps."""
    post = walker(10, 1.5, 0)
    source = np.concatenate([walker(10, 0, 0), walker(10, 1.5, seed)])
    assert np.abs(flow_mps(source, post)).max() == 0


def test_points_without_component_may_be_what_an_object_has_become() -> None:
    """Of a thing that is seen sparsely nine points are left: too few for a component, but they fit."""
    source = walker(10, 0, 0, 12)
    found = flow_mps(source, (source + (0, 1.5, 0))[:9])
    np.testing.assert_allclose(found, np.tile([0.0, 15, 0], (12, 1)), atol=0.5)


def test_noise_gets_no_motion() -> None:
    stray = np.array([[20.0, 9, 1], [20.1, 9, 1], [20.2, 9, 1]])
    source, target = (
        np.concatenate([car(12, 4, 0), stray]),
        np.concatenate([car(13, 4, 1), stray + (1, 0, 0)]),
    )
    found = flow_mps(source, target)
    assert np.abs(found[-3:]).max() == 0
    np.testing.assert_allclose(found[:450].mean(axis=0), [10, 0, 0], atol=0.4)


@pytest.mark.parametrize(("speed_mps", "is_found"), [(24.0, True), (36.0, False)])
def test_motion_is_searched_for_up_to_the_fastest(speed_mps: float, is_found: bool) -> None:
    found = flow_mps(car(12, 4, 0), car(12 + speed_mps * DT_S, 4, 1))
    assert (np.abs(found[:, 0].mean() - speed_mps) < 0.5) == is_found
    faster = flow_mps(car(12, 4, 0), car(12 + speed_mps * DT_S, 4, 1), replace(CONFIG, max_speed_mps=40.0))
    assert np.abs(faster[:, 0].mean() - speed_mps) < 0.5


def test_a_motion_that_lowers_the_misfit_too_little_is_not_taken() -> None:
    """The points of a bush are others in each sweep: some shift fits a little better by chance."""
    bush = [np.random.default_rng(seed).normal((12, -6, 1.2), 0.5, (150, 3)) for seed in (0, 1)]
    bush[1] += (0.25, 0.1, 0)
    strict = replace(FIRST_PASS, max_static_misfit=0.0, min_gain=0.9)
    assert np.abs(flow_mps(*bush, strict)).max() == 0
    lax = replace(FIRST_PASS, max_static_misfit=0.0, min_gain=0.0)
    assert np.abs(flow_mps(*bush, lax)).max() > 0.5


def test_the_misfit_at_rest_decides_whether_a_component_is_static() -> None:
    moved = car(12, 4, 0), car(12.3, 4.2, 1)
    assert np.abs(flow_mps(*moved)).max() > 2
    assert np.abs(flow_mps(*moved, replace(CONFIG, max_static_misfit=5.0))).max() == 0


def test_a_component_that_only_its_screening_sample_calls_dynamic_stays() -> None:
    """A wall, and a post before it, which vanishes: it is every 20th point, and all of the screening sample.

    There is a moved copy of both, which fits exactly; but of all points few are off at rest.
    """
    at = np.arange(640)
    source = np.stack([0.1 * (at % 32), 10.0 + 0 * at, 0.3 + 0.1 * (at // 32)], axis=1)
    post = at % 20 == 0
    source[post] = np.stack([1.5 + 0 * at[:32], 9.4 + 0 * at[:32], 0.3 + 0.05 * at[:32]], axis=1)
    target = np.concatenate([source[~post], source + (0, 1.2, 0)])
    assert np.abs(flow_mps(source, target, FIRST_PASS)).max() == 0


def crossing(seed: int) -> np.ndarray:
    """A parked car, and a walker 0.6 m beside its side: one component with it in both sweeps."""
    return np.concatenate([car(10, 5, seed), walker(9.5 + 0.2 * seed, 3.4, seed + 10)])


def test_a_walker_close_to_a_parked_car_moves_in_the_second_pass() -> None:
    found = flow_mps(crossing(0), crossing(1))
    np.testing.assert_allclose(found[450:].mean(axis=0), [2, 0, 0], atol=0.5)
    assert np.abs(found[:450]).max() == 0
    first = flow_mps(crossing(0), crossing(1), FIRST_PASS)
    assert np.abs(first[450:]).max() == 0, "the component as a whole stands still"


@pytest.mark.parametrize(("min_gain", "moves"), [(0.7, True), (0.8, False)])
def test_a_part_must_gain_twice(min_gain: float, moves: bool) -> None:
    """His motion leaves some 6 % of his misfit at rest: less than 0.3 squared, more than 0.2 squared."""
    found = flow_mps(crossing(0), crossing(1), replace(CONFIG, min_gain=min_gain))
    assert (np.abs(found[450:]).max() > 1e-9) == moves


@pytest.mark.parametrize("dt_s", [0.1, -0.1])
def test_a_fast_car_is_found_forward_and_backward_in_time(dt_s: float) -> None:
    found = estimate_rigid_flow(car(12, 4, 0), [OtherSweep(car(12 + 24 * dt_s, 4, 1), dt_s)], CONFIG)
    np.testing.assert_allclose(found.mean(axis=0), [24, 0, 0], atol=0.4)


def test_a_post_close_to_a_moving_car_comes_to_rest_in_the_second_pass() -> None:
    """In the first pass it goes with the car, which has more points."""
    source = np.concatenate([car(10, 5, 0), walker(11, 3.3, 10, 60)])
    target = np.concatenate([car(10.6, 5.5, 1), walker(11, 3.3, 11, 60)])
    first = flow_mps(source, target, FIRST_PASS)
    assert np.linalg.norm(first[450:], axis=1).min() > 5
    found = flow_mps(source, target)
    np.testing.assert_allclose(found[450:], 0, atol=1e-9)
    np.testing.assert_array_equal(found[:450], first[:450], "what is explained keeps its motion")
    np.testing.assert_allclose(found[:450].mean(axis=0), [6, 5, 0], atol=0.5)


@pytest.mark.parametrize(("count", "moves"), [(39, False), (150, True)])
def test_a_part_of_fewer_than_forty_points_has_no_motion_of_its_own(count: int, moves: bool) -> None:
    source = np.concatenate([car(10, 5, 0), walker(9.5, 3.4, 10, count)])
    target = np.concatenate([car(10, 5, 1), walker(9.7, 3.4, 11, count)])
    assert (np.abs(flow_mps(source, target)[450:]).max() > 0) == moves


def residual(source: np.ndarray, target: np.ndarray, motion_m: tuple[float, ...] = (0, 0, 0)) -> np.ndarray:
    motion = np.tile([*motion_m, 0.0], (len(source), 1))
    label = np.zeros(len(source), np.int64)
    return residual_mask(source, motion, label, (build_tree(source), build_tree(target)), 0.003, CONFIG)


def test_patches_off_the_other_sweep_are_unexplained_until_they_move_there() -> None:
    source, target = crossing(0), crossing(0)
    target[450:] += (1.0, 0, 0)
    found = residual(source, target)
    assert found[450:].mean() > 0.8
    assert found[:450].mean() < 0.15  # those that share a patch with him
    assert not residual(source[450:], target[450:], (1.0, 0, 0)).any()


def test_points_of_different_components_share_no_patch() -> None:
    """Two nets in the same cubes, of which one has moved: each patch is judged by its own points."""
    x, z = (axis.ravel() for axis in np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 2, 0.1)))
    net = np.stack([x, 0 * x + 0.1, z], axis=1)
    source = np.concatenate([net, net + (0.03, 0.1, 0.03)])
    label = np.repeat([0, 1], len(net))
    motion = np.zeros((len(source), 4))
    motion[label == 1, 1] = 3.0
    found = residual_mask(source, motion, label, (build_tree(source), build_tree(source)), 0.003, CONFIG)
    assert found[label == 1].all() and not found[label == 0].any()


def test_a_turn_counts_in_the_residual() -> None:
    """A long wall that turns about the middle of its patches is explained by shift and turn together."""
    x, z = (axis.ravel() for axis in np.meshgrid(np.arange(5, 8, 0.05), np.arange(0, 0.7, 0.05)))
    wall = np.stack([x, 0.01 + 0 * x, z], axis=1)
    cos, sin = np.cos(0.9), np.sin(0.9)
    turned = wall @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    motion = np.column_stack([turned - wall, np.full(len(wall), 0.9)])
    label = np.zeros(len(wall), np.int64)
    trees = build_tree(wall), build_tree(turned)
    assert not residual_mask(wall, motion, label, trees, 0.003, CONFIG).any()
    motion[:, 3] = 0
    assert residual_mask(wall, motion, label, trees, 0.003, CONFIG).any()
