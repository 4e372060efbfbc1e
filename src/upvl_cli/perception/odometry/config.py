"""Settings of odometry; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class KissIcpConfig(Config):
    """Settings of KISS-ICP."""

    voxel_m: float = setting("edge of the voxels of the local map", "m", ge=0.01, le=10)
    min_range_m: float = setting(
        "points nearer than this are left out: they are the car itself", "m", ge=0, le=1000
    )
    max_range_m: float = setting("points farther than this are left out", "m", ge=1, le=1000)
    warm_up_sweeps: int = setting(
        "first sweeps that are registered twice: their last step is the speed at the start; 1 takes the car to stand",
        ge=1,
        le=1000,
    )
    initial_threshold_m: float = setting(
        "deviation from the constant-velocity prediction that is expected at the start", "m", ge=0.01, le=100
    )


@dataclass(frozen=True)
class PathSmoothingConfig(Config):
    """Settings of the smoothing of an estimated path."""

    method: Literal["none", "local-polynomial"] = setting(
        "how estimated positions are smoothed; none: not at all; local-polynomial: local regression over frames"
    )
    half_window_frames: int = setting(
        "frames to each side that take part in a local polynomial", ge=1, le=1000
    )
    degree: int = setting("degree of the local polynomial", ge=1, le=5)
