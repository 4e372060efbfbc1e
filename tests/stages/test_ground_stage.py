"""The stage `ground`: heights above the ground of a data set, and where it knows none above the estimated one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from memory_inputs import MemoryDrive, MemoryInputs

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.stages import ground
from upvl_cli.types import Array, Frame, Points

CONFIG = load(ground.GroundConfig, Path(__file__).parents[2] / "stages" / "ground.toml")


class FlatDrive(MemoryDrive):
    """A flat road 1.7 m below the sensor, points of which lie 3 cm too high."""

    frames = (Frame(4, 0),)
    ground_z_m = -1.7
    name = "drive"

    def __init__(self) -> None:
        x, y = np.meshgrid(np.arange(-20, 20, 0.5), np.arange(-20, 20, 0.5))
        super().__init__({4: np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.67)])})


class MappedDrive(FlatDrive):
    """Its data set knows the road to the left."""

    def ground_z(self, frame: int, xyz_ego_m: Array) -> Array:
        assert frame == 4
        return np.where(xyz_ego_m[:, 1] >= 0, -1.7, np.nan)


def heights(drive: FlatDrive, method: str) -> tuple[Points, Array]:
    config = replace(CONFIG, method=method)
    (row,) = ground.run(MemoryInputs({"odometry": []}, drive=drive), config)
    assert row.height_m.dtype == np.float32
    return drive.points(4), row.height_m


def test_heights_are_estimated_unless_the_map_is_asked_for() -> None:
    assert CONFIG.method == "estimate"
    np.testing.assert_allclose(heights(MappedDrive(), "estimate")[1], 0, atol=1e-3)
    np.testing.assert_array_equal(heights(MappedDrive(), "estimate")[1], heights(FlatDrive(), "estimate")[1])


def test_heights_above_the_map_and_above_the_estimate_where_it_is_unknown() -> None:
    points, height_m = heights(MappedDrive(), "dataset")
    left = points.xyz_ego_m[:, 1] >= 0
    np.testing.assert_allclose(height_m[left], 0.03, atol=1e-5)
    np.testing.assert_array_equal(height_m[~left], heights(FlatDrive(), "estimate")[1][~left])


def test_a_drive_without_a_map_is_refused() -> None:
    with pytest.raises(BadSetting, match=r'the data set of drive has no height map; set method = "estimate"'):
        heights(FlatDrive(), "dataset")
