"""Settings of `upvl check`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.visual.config import CameraCheckConfig


@dataclass(frozen=True)
class SampleConfig(Config):
    """Which sweeps of a drive are looked at."""

    runs: int = setting("moments of a drive that are looked at, spread evenly over it", ge=1, le=10**4)
    sweeps: int = setting("neighbouring sweeps at each moment", ge=1, le=100)


@dataclass(frozen=True)
class CheckConfig(Config):
    """Settings of `check`."""

    sample: SampleConfig = table("Sweeps of a drive that are looked at.")
    quick: SampleConfig = table("Sweeps that the quick part looks at, which `autolabel` asks first.")
    images: int = setting("pictures of a drive that are checked, shared by its cameras", ge=1, le=10**6)
    min_frames: int = setting("frames that are checked of each camera, at least", ge=1, le=10**6)
    max_frames: int = setting("frames that are checked of each camera, at most", ge=1, le=10**6)
    max_delay_s: float = setting("largest time between a picture and its sweep", "s", ge=0, le=100)
    camera: CameraCheckConfig = table("How far the calibration of a camera is off.")
