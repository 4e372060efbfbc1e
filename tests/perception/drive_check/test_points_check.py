"""The check of points: what is wrong with a sweep is named, with its cause and its remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ray_street import CONFIG, drive_sample
from upvl_cli.perception.drive_check.points_check import (
    check_own_car,
    check_points,
    is_same_sweep,
    surface_ratio,
)
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.sensor.coverage import CarFootprint
from upvl_cli.perception.sensor.measure import measure_sensor
from upvl_cli.types import Points


def found(sample: DriveSample) -> list[tuple[str, str]]:
    return [(finding.level, finding.text) for finding in check_points(sample, CONFIG.points)]


def only(change: Callable[[Points, int], Points]) -> tuple[str, str, str]:
    """Return level, cause and remedy of the one finding that is not ok; of the fault where there is one."""
    wrong = [each for each in check_points(drive_sample(change=change), CONFIG.points) if each.level != "ok"]
    (finding,) = [each for each in wrong if each.is_fault and "type" in each.cause] or wrong
    return finding.level, finding.cause, finding.remedy


def _rows(points: Points, width: int, read: int) -> Points:
    """Return points whose rows of `width` numbers were read as rows of another width."""
    columns = [points.xyz_ego_m, points.intensity[:, None], (np.arange(len(points)) % 32)[:, None]]
    values = np.column_stack(columns)[:, :width].ravel()
    values = values[: len(values) // read * read].reshape(-1, read)[: len(points)]
    kept = points[: len(values)]
    return replace(kept, xyz_ego_m=values[:, :3], intensity=values[:, 3])


def test_a_right_drive_has_one_ok() -> None:
    assert [level for level, _ in found(drive_sample())] == ["ok"]
    dark = drive_sample(change=lambda points, step: replace(points, intensity=points.intensity * 0))
    assert [level for level, _ in found(dark)] == ["ok"]


def _nan(points: Points, step: int) -> Points:
    xyz = points.xyz_ego_m.copy()
    xyz[::50] = np.nan
    return replace(points, xyz_ego_m=xyz)


def _zeros(points: Points, step: int) -> Points:
    xyz = points.xyz_ego_m.copy()
    xyz[::50] = 0
    return replace(points, xyz_ego_m=xyz)


def _swapped(points: Points, step: int) -> Points:
    """Return numbers of one byte order read in the other one."""
    return replace(points, xyz_ego_m=points.xyz_ego_m.byteswap())


def _noise(points: Points, step: int) -> Points:
    return replace(points, xyz_ego_m=np.random.default_rng(step).uniform(-50, 50, points.xyz_ego_m.shape))


@pytest.mark.parametrize(
    ("change", "level", "cause", "remedy"),
    [
        (_nan, "fault", "NaN", "without them"),
        (_zeros, "warning", "zeros", "without them"),
        (_swapped, "fault", "bytes read as another type", "true type"),
        (_noise, "fault", "bytes read as another type", "true type"),
        (lambda points, step: _rows(points, 5, 4), "fault", "another column", "columns"),
        (lambda points, step: _rows(points, 3, 4), "fault", "another column", "columns"),
        (
            lambda points, step: replace(points, intensity=points.intensity * 255),
            "warning",
            "0 to 255",
            "intensity_full = 255.0",
        ),
        (
            lambda points, step: replace(points, intensity=points.intensity / 255),
            "warning",
            "divided by 255 twice",
            "intensity_full = 0.003922",
        ),
        (
            lambda points, step: replace(points, intensity=points.intensity * 0 + 0.5),
            "warning",
            "one number",
            "",
        ),
        (
            lambda points, step: points[: len(points) // (1 + step % 2)],
            "warning",
            "lost packets",
            "whole turns",
        ),
        (lambda points, step: points[: len(points) * (step != 0)], "warning", "lost sweeps", ""),
    ],
)
def test_each_fault_is_named(
    change: Callable[[Points, int], Points], level: str, cause: str, remedy: str
) -> None:
    level_found, cause_found, remedy_found = only(change)
    assert level_found == level and cause in cause_found and remedy in remedy_found


def test_no_point_at_all_is_a_fault() -> None:
    assert found(drive_sample(change=lambda points, step: points[:0])) == [
        ("fault", "none in any of 8 sweeps")
    ]


def test_a_repeated_sweep_is_a_fault() -> None:
    right = drive_sample()
    doubled = replace(right, sweep=lambda step: right.sweep(step - step % 2))
    (finding,) = check_points(doubled, CONFIG.points)
    same = [pair for pair in right.pairs if pair[0] % 2 == 0]
    assert finding.is_fault and finding.text.startswith(f"{len(same)} of {len(right.pairs)} sweeps")


def test_the_same_sweep_is_known_under_another_motion_compensation() -> None:
    first, second = drive_sample().sweep(0), drive_sample().sweep(1)
    moved = replace(first, xyz_ego_m=first.xyz_ego_m * 1.01)
    dark = replace(first, intensity=first.intensity * 0)
    assert is_same_sweep(first, moved, 0.005)
    assert is_same_sweep(dark, replace(dark, xyz_ego_m=dark.xyz_ego_m + 0.001), 0.005)
    assert not is_same_sweep(dark, replace(dark, xyz_ego_m=dark.xyz_ego_m + 0.01), 0.005)
    assert not is_same_sweep(first, second, 0.005)
    assert not is_same_sweep(first[:0], first[:0], 0.005)


def test_two_returns_of_a_ray_are_told_but_right() -> None:
    twice = drive_sample(change=lambda points, step: points[np.repeat(np.arange(len(points)), 2)])
    assert [level for level, _ in found(twice)] == ["ok", "ok"]
    assert found(twice)[0][1] == "50% of a sweep lie where another one lies"


def test_surfaces_are_thin_whatever_the_unit() -> None:
    xyz = drive_sample().sweep(0).xyz_ego_m
    assert surface_ratio(xyz, 300) < 0.1
    assert surface_ratio(xyz * 1000, 300) == pytest.approx(surface_ratio(xyz, 300), rel=1e-3)
    assert np.isnan(surface_ratio(xyz[:10], 300))


def test_points_of_the_car_itself_name_the_line_that_leaves_them_out() -> None:
    card = measure_sensor(drive_sample(), CONFIG.sensor)
    assert list(check_own_car(card)) == []
    (finding,) = check_own_car(replace(card, car=CarFootprint((-1.2, 0.9), (-0.8, 0.7), 160)))
    assert finding.level == "warning" and "car_m = [-1.2, 0.9, -0.8, 0.7]" in finding.remedy
