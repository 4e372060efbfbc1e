"""The tightest box around points, by construction and against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.box_fit import median, rectangle_heading, tight_box, to_heading_axes, trimmed_range


def corner(heading_rad: float, spacing_m: float = 0.1) -> np.ndarray:
    """Points on two edges of a rectangle of 4 by 2 m, as a LiDAR sees a car."""
    long = np.column_stack([np.arange(0, 4.001, spacing_m), np.zeros(round(4 / spacing_m) + 1)])
    short = np.column_stack([np.zeros(round(2 / spacing_m) + 1), np.arange(0, 2.001, spacing_m)])
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return np.concatenate([long, short]) @ np.array([[cos, sin], [-sin, cos]]) + [20.0, -7.0]


def plain_heading(xy_m: np.ndarray, step_rad: float, floor_m: float) -> float:
    """Algorithm 3 of Zhang et al. (2017), point by point."""
    best, best_heading = -np.inf, 0.0
    for heading in np.arange(0, np.pi / 2, step_rad):
        along = xy_m @ [np.cos(heading), np.sin(heading)]
        across = xy_m @ [-np.sin(heading), np.cos(heading)]
        closeness = 0.0
        for c in range(len(xy_m)):
            edges = [along[c] - along.min(), along.max() - along[c]]
            edges += [across[c] - across.min(), across.max() - across[c]]
            closeness += 1 / max(min(edges), floor_m)
        if closeness > best + 1e-9:
            best, best_heading = closeness, heading
    return float(best_heading)


@pytest.mark.parametrize("degrees", [0, 17, 45, 73, 89])
def test_the_heading_of_a_corner_is_that_of_its_edges(degrees: int) -> None:
    heading = rectangle_heading(corner(np.deg2rad(degrees)), step_rad=np.deg2rad(1.0), floor_m=0.05)
    assert np.rad2deg(heading) == pytest.approx(degrees, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_heading_is_that_of_the_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = corner(rng.uniform(0, 1.5)) + rng.normal(0, 0.15, (62, 2))
    for floor in (0.01, 0.3):
        found = rectangle_heading(xy, step_rad=0.05, floor_m=floor)
        assert found == pytest.approx(plain_heading(xy, 0.05, floor))


def test_the_heading_of_many_points_is_that_of_every_so_many_th_one() -> None:
    rng = np.random.default_rng(0)
    xy = corner(0.4, 0.01)[:, None] + rng.normal(0, 0.1, (602, 2, 2))
    xy = xy.reshape(-1, 2)[:801]  # 801 points: every third one, at most 400
    found = rectangle_heading(xy, step_rad=0.02, floor_m=0.05)
    assert found == rectangle_heading(xy[::3], step_rad=0.02, floor_m=0.05)


def test_one_point_has_no_heading() -> None:
    assert rectangle_heading(np.array([[3.0, 4.0]]), step_rad=0.1, floor_m=0.05) == 0.0


def test_heading_axes_point_along_and_to_the_left() -> None:
    np.testing.assert_allclose(
        to_heading_axes(np.array([[0.0, 2], [3, 0]]), np.pi / 2), [[2, 0], [0, -3]], atol=1e-12
    )


def test_a_range_leaves_out_its_share_at_each_end() -> None:
    assert trimmed_range(np.arange(101.0), 0.01) == pytest.approx((1, 99))
    assert trimmed_range(np.array([5.0, 1, 9]), 0.0) == (1, 9)


def test_a_tight_box_has_the_size_place_and_heading_of_what_is_in_it() -> None:
    along, across, up = np.meshgrid(np.linspace(-2, 2, 101), [-1.0, 0.0, 1.0], [0.2, 1.7])
    flat = np.column_stack([along.ravel(), across.ravel()])
    xyz = np.column_stack([to_heading_axes(flat, -0.6) + [10.0, 5.0], up.ravel()])
    box = tight_box(xyz, 0.6, trim=0.0)
    np.testing.assert_allclose(box.center_m, [[10, 5, 0.95]], atol=1e-12)
    np.testing.assert_allclose(box.size_lwh_m, [[4, 2, 1.5]], atol=1e-12)
    assert box.heading_rad.tolist() == [0.6]


def test_stray_points_stretch_no_length_and_no_width_but_height() -> None:
    points = np.column_stack([np.linspace(0, 1, 400), np.tile([0.0, 1.0], 200), np.linspace(0, 1, 400)])
    stray = np.concatenate([points, [[9.0, 0, 0], [0, -9.0, 0], [0, 0, 5.0]]])
    box = tight_box(stray, 0.0, trim=0.01)
    np.testing.assert_allclose(box.size_lwh_m, [[1, 1, 5]], atol=0.03)
    np.testing.assert_allclose(box.center_m, [[0.5, 0.5, 2.5]], atol=0.03)


@pytest.mark.parametrize("count", [1, 2, 3, 6, 41, 200])
def test_ranges_and_medians_are_those_of_numpy_to_the_bit(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    for trim in (0.0, 0.01, 0.1, 0.25):
        assert trimmed_range(values, trim) == tuple(np.quantile(values, (trim, 1.0 - trim)))
    assert median(values) == np.median(values)
