"""Each rule of the ground map alone, against arithmetic by hand or a plain loop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.ground import height as ground
from upvl_cli.perception.ground.height import height_above_ground
from upvl_cli.stages.ground import GroundConfig

# A small map: 20 x 20 cells of 1 m about the car.
CONFIG = replace(
    load(GroundConfig, Path(__file__).parents[2] / "stages" / "ground.toml").map, half_extent_m=10.0
)
SIZE = 20


def flat(cell_m: float = 1.0, half_extent_m: float = 10.0) -> np.ndarray:
    """One point in the middle of each cell, at height 0."""
    at = np.arange(-half_extent_m + cell_m / 2, half_extent_m, cell_m)
    x, y = (axis.ravel() for axis in np.meshgrid(at, at, indexing="ij"))
    return np.stack([x, y, 0 * x], axis=1)


def raised(points: np.ndarray, x_m: float, y_m: float, z_m: float) -> np.ndarray:
    """The points, of which the one at a place has another height."""
    points = points.copy()
    points[(points[:, 0] == x_m) & (points[:, 1] == y_m), 2] = z_m
    return points


def random_map(seed: int, *, known: float = 0.6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low = rng.normal(0, 0.4, (12, 12))
    low[rng.uniform(size=low.shape) > known] = np.inf
    return low


@pytest.mark.parametrize("cell_m", [0.5, 1.0, 2.0])
def test_each_cell_has_the_height_and_the_position_of_its_lowest_point(cell_m: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-12, 12, (4000, 3))  # some outside of the map
    sweep = ground._project(points, replace(CONFIG, cell_m=cell_m))
    lowest = ground._lowest_points(sweep)
    assert lowest.z_m.shape == (20 / cell_m, 20 / cell_m)
    for i in range(0, sweep.size, 3):
        for j in range(0, sweep.size, 3):
            x, y = -10 + i * cell_m, -10 + j * cell_m
            inside = (points[:, 0] >= x) & (points[:, 0] < x + cell_m)
            inside &= (points[:, 1] >= y) & (points[:, 1] < y + cell_m)
            if not inside.any():
                assert lowest.z_m[i, j] == np.inf
                continue
            true = points[inside][points[inside][:, 2].argmin()]
            assert lowest.z_m[i, j] == true[2]
            found = np.array([lowest.row[i, j], lowest.column[i, j]]) * cell_m - 10
            np.testing.assert_allclose(found, true[:2], atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1], ids=["below", "above"])
def test_a_lowest_point_lies_near_the_road_that_the_sensor_expects(side: int) -> None:
    """At 3.5, 4.5 m from the car: 1 m and a quarter of the distance."""
    bound_m = 1.0 + 0.25 * np.hypot(3.5, 4.5)
    for excess_m, is_kept in ((-0.01, True), (0.01, False)):
        low = np.full((SIZE, SIZE), np.inf)
        low[13, 14] = -1.7 + side * (bound_m + excess_m)
        assert np.isfinite(ground._reject_implausible(low, -1.7, CONFIG)[13, 14]) == is_kept


def test_cells_below_the_car_have_the_height_that_the_sensor_expects() -> None:
    low = np.full((SIZE, SIZE), np.inf)
    low[10, 11] = -1.5
    found = ground._reject_implausible(low, -1.7, CONFIG)
    center = np.arange(SIZE) - 9.5
    below_car = np.hypot(center[:, None], center) < 2.5
    expected = np.where(below_car, -1.7, np.inf)
    expected[10, 11] = -1.5  # what is seen there counts
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("cell_m", [0.5, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_support_is_counted_as_in_a_plain_loop(seed: int, cell_m: float) -> None:
    low = random_map(seed, known=[0.1, 0.3, 0.6, 1.0][seed])
    config = replace(CONFIG, cell_m=cell_m, max_slope=0.05)
    expected = np.zeros(low.shape, dtype=bool)
    for i, j in np.argwhere(np.isfinite(low)):
        window = [
            (a, b)
            for a in range(i - 3, i + 4)
            for b in range(j - 3, j + 4)
            if 0 <= min(a, b) <= max(a, b) < 12
        ]
        known = [(a, b) for a, b in window if np.isfinite(low[a, b])]
        agree = [
            abs(low[a, b] - low[i, j]) <= 0.15 + 0.05 * np.hypot(a - i, b - j) * cell_m for a, b in known
        ]
        expected[i, j] = sum(agree) >= 3 and sum(agree) >= 0.3 * len(known)
    assert seed == 3 or expected.any() or seed == 0
    np.testing.assert_array_equal(ground._is_supported(low, config), expected)


def test_two_points_that_agree_are_no_ground_and_three_are() -> None:
    low = np.full((9, 9), np.inf)
    low[4, 4] = low[4, 5] = 0.0
    assert not ground._is_supported(low, CONFIG).any()
    low[5, 4] = 0.0
    assert ground._is_supported(low, CONFIG).sum() == 3


def test_a_lowest_point_without_support_does_not_lower_the_ground() -> None:
    """At 0.45 m below its neighbors it is not deep enough for a mirror image; ground is nearly flat here."""
    flat_land = replace(CONFIG, max_slope=0.02)
    found = height_above_ground(raised(flat(), 5.5, 5.5, -0.45), 0.0, flat_land)
    beside = found[(flat()[:, 0] == 5.5) & (flat()[:, 1] == 6.5)]
    assert np.abs(beside).max() < 1e-6
    unchecked = replace(flat_land, min_support_share=0.0, min_support_cells=1)
    found = height_above_ground(raised(flat(), 5.5, 5.5, -0.45), 0.0, unchecked)
    assert found[(flat()[:, 0] == 5.5) & (flat()[:, 1] == 6.5)].min() > 0.005


def test_the_envelope_is_a_cone_over_the_lowest_cell() -> None:
    """A rise of 0.2 a metre along rows and diagonals, over 8 cells of 0.5 m and no further."""
    low = np.full((25, 25), 50.0)
    low[12, 12] = 1.0
    found = ground._lower_envelope(low, replace(CONFIG, cell_m=0.5))
    assert found[12, 12] == 1.0
    assert found[12, 13] == pytest.approx(1.0 + 0.2 * 0.5)
    assert found[15, 16] == pytest.approx(1.0 + 0.2 * 0.5 * (3 * np.sqrt(2) + 1))
    assert found[20, 12] == pytest.approx(1.0 + 0.2 * 0.5 * 8)
    assert found[21, 12] == 50.0


def test_ground_that_an_object_hides_is_carried_below_it() -> None:
    """A block of 6 x 6 cells of 0.5 m at 0.6 m: what is 0.15 m above the envelope is no ground."""
    points = flat(0.5)
    block = (np.abs(points[:, 0] - 5) < 1.5) & (np.abs(points[:, 1]) < 1.5)
    points[block, 2] = 0.6
    config = replace(CONFIG, cell_m=0.5)
    found = height_above_ground(points, 0.0, config)
    np.testing.assert_allclose(found[block], 0.6, atol=0.01)
    unrefined = replace(config, envelope_reach_cells=0, refinements=0)
    carried_no_further = height_above_ground(points, 0.0, unrefined)
    assert carried_no_further[block].min() < 0.5


@pytest.mark.parametrize(
    ("above_m", "is_obstacle"), [(0.3, False), (0.4, True), (0.95, True), (1.05, False)], ids=str
)
def test_an_obstacle_is_a_point_a_little_above_the_lowest(above_m: float, is_obstacle: bool) -> None:
    points = np.concatenate([flat(), [[3.2, 4.2, above_m]]])
    sweep = ground._project(points, CONFIG)
    found = ground._has_obstacle(sweep, ground._lowest_points(sweep).z_m, CONFIG)
    assert found[13, 14] == is_obstacle
    assert found.sum() == is_obstacle


def test_the_lowest_points_of_cells_with_obstacles_are_no_ground_at_first() -> None:
    """Hedges whose foot is hidden up to 0.6 m are not ground, though they are level and agree with each other."""
    steep = replace(CONFIG, max_slope=10.0)
    points = flat()
    foot = points[:, 0] > 4
    points[foot, 2] = 0.6
    found = height_above_ground(np.concatenate([points, points[foot] + (0, 0, 0.5)]), 0.0, steep)
    np.testing.assert_allclose(found[: len(points)][foot], 0.6, atol=0.02)
    as_terrace = height_above_ground(points, 0.0, steep)
    assert np.abs(as_terrace[points[:, 0] > 6]).max() < 0.1, (
        "without the points above them they are a terrace"
    )


@pytest.mark.parametrize("density", [0.01, 0.05, 0.2, 0.9])
def test_the_smallest_window_with_enough_ground_is_taken(density: float) -> None:
    is_ground = np.random.default_rng(0).uniform(size=(40, 40)) < density
    count = np.zeros((41, 41))
    count[1:, 1:] = is_ground.cumsum(axis=0).cumsum(axis=1)
    found = ground._window_reach(count, CONFIG)
    for i in range(0, 40, 3):
        for j in range(0, 40, 3):
            enough = [
                reach
                for reach in (2, 4, 8, 16, 32, 64)
                if is_ground[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1].sum() >= 6
            ]
            assert found[i, j] == (enough[0] if enough else 40)


def test_windows_count_in_any_order() -> None:
    points = flat()
    points[:, 2] = np.random.default_rng(0).normal(0, 0.05, len(points))
    reordered = replace(CONFIG, window_cells=CONFIG.window_cells[::-1])
    np.testing.assert_array_equal(
        height_above_ground(points, 0.0, reordered), height_above_ground(points, 0.0, CONFIG)
    )


@pytest.mark.parametrize(("pit_m", "is_mirror_image"), [(-0.7, True), (-0.45, False)])
def test_a_lowest_point_far_below_the_plane_is_no_ground(pit_m: float, is_mirror_image: bool) -> None:
    alone = replace(CONFIG, max_slope=10.0, min_support_share=0.0)
    found = height_above_ground(raised(flat(), 5.5, 5.5, pit_m), 0.0, alone)
    beside = found[(flat()[:, 0] == 5.5) & (flat()[:, 1] == 6.5)]
    assert (np.abs(beside) < 1e-6).all() == is_mirror_image
    assert (beside > 0.01).all() != is_mirror_image


@pytest.mark.parametrize(("step_m", "is_ground"), [(0.02, True), (0.13, False), (0.25, False)])
def test_a_step_up_to_the_tolerance_is_ground(step_m: float, is_ground: bool) -> None:
    """Half of the map is higher; a single cell that stands out by more than the tolerance is not followed."""
    alone = replace(CONFIG, max_slope=10.0, min_support_share=0.0)
    found = height_above_ground(raised(flat(), 5.5, 5.5, step_m), 0.0, alone)
    beside = found[(flat()[:, 0] == 5.5) & (flat()[:, 1] == 6.5)]
    assert (np.abs(beside) < 1e-6).all() != is_ground


def test_on_a_slope_a_lowest_point_is_compared_with_the_plane_at_its_own_position() -> None:
    """A hillside that rises by 0.5 a metre, seen at the upper edge of each cell."""
    hillside = flat() + (0.45, 0, 0)
    hillside[:, 2] = 0.5 * hillside[:, 0]
    found = height_above_ground(hillside, 0.0, replace(CONFIG, max_slope=10.0, prior_slope=1.0))
    inner = np.abs(hillside[:, :2]).max(axis=1) < 5
    np.testing.assert_allclose(found[inner], 0, atol=0.1)


def test_ground_near_an_obstacle_counts_after_the_first_planes() -> None:
    """Every second row has grass 0.5 m above the ground; all ground is smoothed over nevertheless."""
    points = flat()
    points[:, 2] = np.where(points[:, 0] % 2 == 0.5, 0.04, 0.0)
    grass = points[points[:, 0] % 2 == 0.5] + (0, 0, 0.5)
    found = height_above_ground(np.concatenate([points, grass]), 0.0, CONFIG)[: len(points)]
    inner = np.abs(points[:, :2]).max(axis=1) < 6
    assert np.abs(found[inner & (points[:, 2] > 0)]).max() < 0.03


def test_heights_between_cells_are_bilinear() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-9.4, 9.4, (200, 3))
    sweep = ground._project(points, CONFIG)
    row, column = np.indices((SIZE, SIZE)) - 9.5  # centers, in metres
    found = ground._interpolate(1 + 0.3 * row - 0.2 * column + 0.1 * row * column, sweep)
    x, y, _ = points.T
    np.testing.assert_allclose(found, 1 + 0.3 * x - 0.2 * y + 0.1 * x * y, atol=1e-9)


def test_just_the_cells_about_a_point_carry_its_height() -> None:
    sweep = ground._project(np.array([[3.2, -4.8, 0.0]]), CONFIG)
    assert np.argwhere(ground._corner_cells(sweep)).tolist() == [[12, 4], [12, 5], [13, 4], [13, 5]]


def test_a_bare_line_of_ground_has_no_tilt_across() -> None:
    """Cells in one row say nothing about the slope across it, which the damping holds at zero."""
    x = np.arange(-9.5, 10)
    line = np.stack([x, np.full(20, 0.5), 0.1 * x + np.tile([0.02, -0.02], 10)], axis=1)
    probe = np.array([[0.5, 4.5, 1.0]])
    found = height_above_ground(np.concatenate([line, probe]), 0.0, replace(CONFIG, blind_radius_m=0.0))[-1]
    assert found == pytest.approx(1.0 - 0.05, abs=0.05)


@pytest.mark.parametrize("slope", [0.0, 0.1, 0.2])
def test_verges_in_wide_windows_do_not_lift_the_road(slope: float) -> None:
    """Far away one cell in four is seen; a third of those are verges 0.12 m above the road."""
    rng = np.random.default_rng(0)
    road = flat(1.0)
    road = road[rng.random(len(road)) < 0.25]
    is_verge = rng.random(len(road)) < 0.33
    road[:, 2] = slope * road[:, 0] + 0.12 * is_verge
    steep = replace(CONFIG, prior_slope=1.0)
    found = height_above_ground(road, 0.0, steep)[~is_verge & (np.abs(road[:, :2]).max(axis=1) < 8)]
    lifted = height_above_ground(road, 0.0, replace(steep, refinements=0))
    lifted = lifted[~is_verge & (np.abs(road[:, :2]).max(axis=1) < 8)]
    assert np.median(found) > np.median(lifted) + 0.015
    assert np.abs(found).max() < 0.1 + slope
