"""Which camera sees which point."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import from_yaw
from upvl_cli.perception.visual.views import (  # fmt: skip
    NO_CAMERA,
    NO_VIEW,
    OCCLUDED,
    SEEN,
    Visibility,
    _behind_raised,
    best_camera,
    move_to_time,
    sample_bilinear,
    visibility,
)
from upvl_cli.stages.extract_vl import ExtractVlConfig
from upvl_cli.types import Camera

AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera("front", 640, 400, np.array([[500.0, 0, 320], [0, 500, 200], [0, 0, 1]]), np.zeros(5), AHEAD)
CONFIG = load(ExtractVlConfig, Path(__file__).parents[3] / "stages" / "extract-vl.toml").visibility


def states(xyz: np.ndarray, stands: np.ndarray | None = None, glass_m: float = 0.0) -> np.ndarray:
    stands = np.zeros(len(xyz), bool) if stands is None else stands
    return visibility(CAMERA, xyz, stands, replace(CONFIG, glass_height_m=glass_m)).state


def wall(x: float, y: tuple[float, float], z: tuple[float, float], step_deg: float = 0.3) -> np.ndarray:
    """Points of an upright wall across the view, as far apart as beams are."""
    step = np.tan(np.deg2rad(step_deg)) * x
    across, up = np.meshgrid(np.arange(*y, step), np.arange(*z, step))
    return np.stack([np.full(across.size, x), across.ravel(), up.ravel()], axis=1)


def test_what_lies_behind_a_wall_is_hidden_and_what_lies_beside_it_is_not() -> None:
    near, far = wall(10, (-2, 2), (-1, 1)), wall(30, (-12, 12), (-4, 4))
    found = states(np.concatenate([near, far]))
    assert (found[: len(near)] == SEEN).all()
    # Seen through the wall, or so near to its edge that they may be hidden: not told by a beam or two.
    behind = (np.abs(far[:, 1]) < 5.5) & (np.abs(far[:, 2]) < 2.5)
    beside = (np.abs(far[:, 1]) > 7.0) | (np.abs(far[:, 2]) > 3.9)
    assert (found[len(near) :][behind] == OCCLUDED).all()
    assert (found[len(near) :][beside] == SEEN).all()


def test_the_road_does_not_lie_on_the_roof_of_a_car_whose_windows_return_nothing() -> None:
    door, road = wall(8, (-2, 2), (-1.5, -0.8)), np.array([[x, 0.0, -1.5] for x in np.arange(20.0, 60)])
    stands = np.arange(len(door) + len(road)) < len(door)
    both = np.concatenate([door, road])
    beyond = states(both, stands, glass_m=0.7)[len(door) :]
    appears_m = -1.5 / road[:, 0] * 8 + 0.8  # above the door, in its plane
    assert (beyond[appears_m < 0.65] == OCCLUDED).all()
    assert (beyond[appears_m > 0.75] == SEEN).all()
    assert (states(both, glass_m=0.7) == states(both)).all(), "what does not stand hides no more"


def test_the_road_and_a_receding_wall_are_seen() -> None:
    road = np.array(
        [[x, y, -1.7] for x in 1.7 / np.tan(np.deg2rad(np.arange(2.0, 12, 0.4))) for y in (-2, 0, 2)]
    )
    side = np.array([[x, 4.0, z] for x in np.arange(8, 50, 0.4) for z in np.arange(-1.5, 2, 0.2)])
    for surface in (road, side):
        found = states(surface)
        assert (found == SEEN).sum() > 0.99 * (found != NO_VIEW).sum()
        assert (found == SEEN).sum() > len(surface) // 3


def test_the_border_and_what_is_behind_the_camera_are_no_view() -> None:
    xyz = np.array(
        [[10.0, 0, 0], [-10, 0, 0], [10, 6.38, 0], [10, 7, 0]]
    )  # the third: one pixel from the edge
    assert states(xyz).tolist() == [SEEN, NO_VIEW, NO_VIEW, NO_VIEW]


def test_ground_behind_what_stands_as_told_row_by_row() -> None:
    rng = np.random.default_rng(0)
    for points in (1, 40, 4000):
        uv_px = rng.uniform((0, 0), (300, 200), (points, 2))
        depth_m, stands = rng.uniform(0.5, 80, points), rng.random(points) < 0.5
        column, row = ((uv_px + 0.5) / 2).astype(int).T
        nearest = np.full((101, 151), np.inf)
        for place in np.flatnonzero(stands):
            reach = int(500 / depth_m[place] / 2)
            cells = nearest[
                max(row[place] - reach, 0) : row[place] + 1, max(column[place] - 1, 0) : column[place] + 2
            ]
            np.minimum(cells, depth_m[place], out=cells)
        config = replace(CONFIG, glass_height_m=1.0)
        expected = ~stands & (nearest[row, column] < 0.7 * depth_m)
        np.testing.assert_array_equal(_behind_raised(uv_px, depth_m, stands, 500, config), expected)


def test_no_points() -> None:
    assert len(states(np.zeros((0, 3)))) == 0


def test_the_best_view_is_the_one_farthest_from_its_border() -> None:
    def one(state: list[int], inset: list[float]) -> Visibility:
        return Visibility(np.zeros((4, 2)), np.array(state, np.int8), np.array(inset))

    left = one([SEEN, SEEN, OCCLUDED, NO_VIEW], [10, 50, 90, -1])
    right = one([SEEN, OCCLUDED, NO_VIEW, NO_VIEW], [40, 90, -1, -1])
    choice = best_camera([left, right], 4)
    assert choice.camera.tolist() == [1, 0, NO_CAMERA, NO_CAMERA]
    assert choice.state.tolist() == [SEEN, SEEN, OCCLUDED, NO_VIEW]
    assert best_camera([], 2).state.tolist() == [NO_VIEW, NO_VIEW]


def test_points_are_brought_to_the_time_of_the_picture() -> None:
    frame, image = from_yaw(0.0, np.array([100.0, 0, 0])), from_yaw(0.0, np.array([101.0, 0, 0]))
    # The car goes on by 1 m; the second point moves on by 2 m/s for 0.1 s.
    xyz = move_to_time(
        np.array([[10.0, 0, 0], [10, 0, 0]]), np.array([[0.0, 0, 0], [2, 0, 0]]), 0.1, frame, image
    )
    np.testing.assert_allclose(xyz, [[9, 0, 0], [9.2, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(move_to_time(xyz, None, 0.1, frame, frame), xyz)


@pytest.mark.parametrize("cell", [4, 8])
def test_features_are_sampled_where_the_pixel_lies(cell: int) -> None:
    """Cells that hold their own centre in pixels give each pixel its own place."""
    wide, high = 640 // cell, 400 // cell
    across, down = np.meshgrid((np.arange(wide) + 0.5) * cell - 0.5, (np.arange(high) + 0.5) * cell - 0.5)
    cells = np.stack([across, down], axis=2).astype(np.float32)
    uv = np.random.default_rng(0).uniform([cell, cell], [640 - cell, 400 - cell], (50, 2))
    np.testing.assert_allclose(sample_bilinear(cells, uv, 640, 400), uv, atol=1e-3)
    corners = np.array([[-0.5, -0.5], [639.5, 399.5]])
    np.testing.assert_allclose(sample_bilinear(cells, corners, 640, 400), [cells[0, 0], cells[-1, -1]])


def test_a_point_is_in_view_from_the_border_on() -> None:
    """The picture spans y from -6.4 to 6.38 m at a depth of 10 m, and z from -4 to 3.98 m."""
    px_m = 10 / 500
    inset_px = np.array([1.9, 2.1])
    left = np.column_stack([[10.0, 10], (320.5 - inset_px) * px_m, [0, 0]])
    right = np.column_stack([[10.0, 10], -(319.5 - inset_px) * px_m, [0, 0]])
    top = np.column_stack([[10.0, 10], [0, 0], (200.5 - inset_px) * px_m])
    bottom = np.column_stack([[10.0, 10], [0, 0], -(199.5 - inset_px) * px_m])
    for points in (left, right, top, bottom):
        seen = visibility(CAMERA, points, np.zeros(2, bool), CONFIG)
        np.testing.assert_allclose(seen.inset_px, inset_px, atol=1e-6)
        assert seen.state.tolist() == [NO_VIEW, SEEN]


def at(u_px: float, v_px: float, depth_m: float) -> list[float]:
    """A point that appears at a pixel."""
    return [depth_m, (320 - u_px) * depth_m / 500, (200 - v_px) * depth_m / 500]


@pytest.mark.parametrize(
    ("offsets_px", "occluded"),
    [
        ([(-8, 0), (8, 0)], True),  # left and right
        ([(0, -8), (0, 8)], True),  # above and below
        ([(-8, 0), (0, 8)], False),  # left and below only
        ([(-8, 0)], False),
        ([(0, 8)], False),
        ([(-8, 2), (8, -2)], True),  # a neighboring row of cells counts
        ([(-8, 4), (8, 4)], False),  # the next one does not
        ([(-12, 0), (12, 0)], False),  # beyond the gap of 0.9 degrees, 7.85 pixels: 4 cells
    ],
)
def test_closer_surfaces_on_both_sides_occlude_a_point(
    offsets_px: list[tuple[int, int]], occluded: bool
) -> None:
    point = at(300, 150, 20)
    around = [at(300 + du, 150 + dv, 16) for du, dv in offsets_px]  # not below 0.7 of the depth
    assert states(np.array([point, *around]))[0] == (OCCLUDED if occluded else SEEN)


@pytest.mark.parametrize(("closer_m", "occluded"), [(17.6, False), (17.4, True)])
def test_what_occludes_is_closer_by_half_a_meter_and_a_tenth(closer_m: float, occluded: bool) -> None:
    sides = [at(292, 150, closer_m), at(308, 150, closer_m)]  # the limit is 20 - 0.5 - 2 m
    assert states(np.array([at(300, 150, 20), *sides]))[0] == (OCCLUDED if occluded else SEEN)
    one_side = [at(292, 150, 10), at(308, 150, 19.9)]
    assert states(np.array([at(300, 150, 20), *one_side]))[0] == OCCLUDED, (
        "very much closer: one side is enough"
    )


@pytest.mark.parametrize(("closer_m", "occluded"), [(14.1, False), (13.9, True)])
@pytest.mark.parametrize("offset", [(-8, 0), (8, 0), (0, -8), (0, 8)])
def test_what_is_closer_than_seven_tenths_occludes_from_any_one_side(
    offset: tuple[int, int], closer_m: float, occluded: bool
) -> None:
    near = at(300 + offset[0], 150 + offset[1], closer_m)
    assert states(np.array([at(300, 150, 20), near]))[0] == (OCCLUDED if occluded else SEEN)


def test_the_nearest_point_of_a_cell_counts() -> None:
    sides = [at(292, 150, depth) for depth in (30, 10, 25)]
    assert states(np.array([at(300, 150, 20), *sides]))[0] == OCCLUDED


def test_no_ground_is_hidden_where_glass_has_no_height() -> None:
    """The road that appears above a door is seen, where it would lie on the window of that door."""
    door, road = wall(8, (-2, 2), (-1.5, -0.8)), np.array([[x, 0.0, -1.5] for x in np.arange(20.0, 36)])
    raised = np.arange(len(door) + len(road)) < len(door)
    both = np.concatenate([door, road])
    above_door = -1.5 / road[:, 0] * 8 + 0.8 > 0.1
    assert (states(both, raised, glass_m=0.0)[len(door) :][above_door] == SEEN).all()


def test_a_single_cell_has_one_feature() -> None:
    cells = np.array([[[3.0, 4.0]]], np.float32)
    np.testing.assert_allclose(sample_bilinear(cells, np.array([[0.0, 0.0], [63, 39]]), 64, 40), [[3, 4]] * 2)


@pytest.mark.parametrize(
    ("above_door_m", "state"), [(0.1, OCCLUDED), (0.3, OCCLUDED), (0.4, SEEN), (0.6, SEEN)]
)
def test_glass_hides_the_ground_up_to_its_height_and_no_farther(above_door_m: float, state: int) -> None:
    """One point of the road, that appears so far above the points of a door, in the plane of the door."""
    door = wall(8, (-2, 2), (-1.5, -0.8))
    road = [1.5 * 8 / (door[:, 2].max() * -1 - above_door_m), 0.0, -1.5]
    raised = np.arange(len(door) + 1) < len(door)
    assert states(np.concatenate([door, [road]]), raised, glass_m=0.35)[-1] == state


def test_the_numbers_of_states_are_those_that_tables_hold() -> None:
    assert (SEEN, OCCLUDED, NO_VIEW) == (0, 1, 2)
