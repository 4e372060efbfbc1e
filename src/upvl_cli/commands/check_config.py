"""Settings of `upvl check`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.drive_check.camera_config import CamerasConfig
from upvl_cli.perception.drive_check.clock_check import ClockCheckConfig
from upvl_cli.perception.drive_check.label_config import LabelCheckConfig
from upvl_cli.perception.drive_check.motion_config import MotionCheckConfig
from upvl_cli.perception.drive_check.points_check import PointsCheckConfig
from upvl_cli.perception.drive_check.units_check import UnitsCheckConfig
from upvl_cli.perception.sensor.config import SensorConfig


@dataclass(frozen=True)
class SampleConfig(Config):
    """Which sweeps of a drive are looked at."""

    runs: int = setting("moments of a drive that are looked at, spread evenly over it", ge=1, le=10**4)
    sweeps: int = setting("neighbouring sweeps at each moment", ge=1, le=100)


@dataclass(frozen=True)
class QuickSampleConfig(SampleConfig):
    """Which sweeps and pictures of a drive the quick part looks at."""

    pictures: int = setting("pictures of each camera that are looked at", ge=1, le=10**4)


@dataclass(frozen=True)
class CheckConfig(Config):
    """Settings of `check`."""

    sample: SampleConfig = table("What is looked at of a drive.")
    quick: QuickSampleConfig = table("What the quick part looks at, which `autolabel` asks first.")
    camera: CamerasConfig = table("Cameras and their pictures.")
    motion: MotionCheckConfig = table("Poses, axes and motion compensation, by the sweeps themselves.")
    sensor: SensorConfig = table("How the sensors of a drive are measured.")
    points: PointsCheckConfig = table("What sweeps may hold.")
    units: UnitsCheckConfig = table("What points in metres look like.")
    clock: ClockCheckConfig = table("What the times of sweeps may do.")
    labels: LabelCheckConfig = table("Human labels, where `check` is asked for them.")
