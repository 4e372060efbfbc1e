"""The check of units: another unit than metres is named with the factor that mends it, an unusual car is no fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ray_street import CONFIG, Lidar, drive_sample
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.drive_check.units_check import UNITS, check_units


def finding(sample: DriveSample) -> Finding:
    (found,) = check_units(sample, CONFIG.units)
    return found


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "metres"])
@pytest.mark.parametrize("axes_z_m", [0.0, 1.8])
def test_each_unit_is_named(unit: str, axes_z_m: float) -> None:
    factor = UNITS[unit]
    spoilt = drive_sample(
        change=lambda points, step: replace(points, xyz_ego_m=points.xyz_ego_m / factor), axes_z_m=axes_z_m
    )
    found = finding(spoilt)
    assert found.is_fault and found.cause == f"points in {unit}"
    assert f"metres_per_unit = {factor:g} under" in found.remedy


@pytest.mark.parametrize(
    "lidar",
    [
        Lidar((0.0, 0.0, 0.5), tuple(np.linspace(-15, 15, 16))),  # a robot
        Lidar((2.0, 0.0, 3.5), tuple(np.linspace(-30, 10, 64))),  # a truck
        Lidar((0.0, 0.0, 1.73), tuple(np.linspace(-25, 3, 64)), columns=600),
    ],
)
@pytest.mark.parametrize("on_road", [True, False])
def test_unusual_cars_are_right(lidar: Lidar, on_road: bool) -> None:
    axes_z_m = 0.0 if on_road else lidar.origin_m[2]
    assert finding(drive_sample([lidar], axes_z_m=axes_z_m)).level == "ok"


def test_too_few_points_cannot_tell() -> None:
    assert finding(drive_sample(change=lambda points, step: points[:100])).level == "cannot tell"


def test_what_fits_no_unit_is_a_warning() -> None:
    flat = drive_sample(
        change=lambda points, step: replace(points, xyz_ego_m=points.xyz_ego_m * [1, 1, 12]), axes_z_m=1.8
    )
    found = finding(flat)
    assert found.level == "warning" and found.remedy == ""
