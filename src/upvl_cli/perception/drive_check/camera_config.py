"""Settings of the checks of cameras and pictures."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.visual.config import CameraAxesConfig, CameraCheckConfig


@dataclass(frozen=True)
class PictureCheckConfig(Config):
    """What a picture must show so that something can be seen in it."""

    max_delay_s: float = setting("largest time between a picture and its sweep", "s", ge=0, le=100)
    many_missing: float = setting("share of missing pictures from which on labels suffer", ge=0, le=1)
    min_pictures: int = setting(
        "fewest pictures from which anything but their absence is said", ge=1, le=1000
    )
    dark: float = setting("a picture whose grey is below this nearly everywhere is black", gt=0, le=255)
    bright: float = setting("a picture whose grey is above this nearly everywhere is white", gt=0, le=255)
    min_contrast: float = setting(
        "a picture whose grey varies by less than this standard deviation is empty", gt=0, le=255
    )
    min_travel_m: float = setting(
        "a car that went farther sees another picture, for equal pictures to be a fault", "m", gt=0, le=1000
    )


@dataclass(frozen=True)
class CamerasConfig(Config):
    """Checks of cameras and their pictures."""

    images: int = setting("pictures of a drive that are checked, shared by its cameras", ge=1, le=10**6)
    min_frames: int = setting("frames that are checked of each camera, at least", ge=1, le=10**6)
    max_frames: int = setting("frames that are checked of each camera, at most", ge=1, le=10**6)
    min_scenes: int = setting(
        "fewest different pictures of a camera from which a calibration is judged", ge=1, le=1000
    )
    clear_sigmas: float = setting(
        "agreement in standard deviations from which one explanation of a camera is clear", ge=0, le=100
    )
    better_sigmas: float = setting(
        "another explanation is better than the given one by at least these standard deviations", ge=0, le=100
    )
    picture: PictureCheckConfig = table("What a picture must show.")
    axes: CameraAxesConfig = table("Which way a camera looks, roughly.")
    calibration: CameraCheckConfig = table("How far the calibration of a camera is off.")
