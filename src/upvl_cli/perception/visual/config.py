"""Settings of the algorithms that bring pictures and sweeps together."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class VisibilityConfig(Config):
    """Which points of a sweep a camera sees."""

    border_px: float = setting(
        "a point nearer than this to the border of a picture is out of view", "px", ge=0, le=1000
    )
    gap_deg: float = setting(
        "largest angle, seen from the camera, between neighboring points of one surface",
        "degrees",
        ge=0.01,
        le=20,
    )
    min_depth_gap_m: float = setting(
        "a surface hides a point only if it is closer to the camera by this depth", "m", ge=0, le=100
    )
    min_depth_gap_share: float = setting(
        "a surface hides a point only if it is also closer by this share of the point's depth", ge=0, le=1
    )
    one_sided_depth_share: float = setting(
        "a surface closer than this share of a point's depth hides the point from one side alone", ge=0, le=1
    )
    glass_height_m: float = setting(
        "a raised surface hides the ground far behind it up to this height above its points, because glass "
        "returns no LiDAR beam",
        "m",
        ge=0,
        le=10,
    )
    cell_px: float = setting("side of a cell of the depth map that hides points", "px", ge=0.1, le=100)


@dataclass(frozen=True)
class OutlineConfig(Config):
    """Where a near surface ends before a far one, in the sweep as the camera sees it."""

    min_points: int = setting("fewest points in view of the camera", ge=20, le=10**6)
    neighbors: int = setting("nearest LiDAR samples compared with each point, itself included", ge=2, le=1000)
    reach_steps: float = setting(
        "a far surface is looked for up to this many LiDAR sample steps beyond a point", ge=0.5, le=100
    )
    min_range_gap_m: float = setting(
        "a far surface is farther from the camera by at least this range", "m", ge=0, le=100
    )
    min_range_gap_share: float = setting(
        "a far surface is farther by at least this share of the point's range", ge=0, le=1
    )
    same_surface_m: float = setting(
        "samples of one surface differ in range by less than this, plus same_surface_share", "m", ge=0, le=100
    )
    same_surface_share: float = setting(
        "samples of one surface differ in range by less than this share of the range, plus same_surface_m",
        ge=0,
        le=1,
    )


@dataclass(frozen=True)
class CameraCheckConfig(Config):
    """How far the calibration of a camera is off, from outlines in sweeps and edges in pictures."""

    tolerance_deg: float = setting("a rotation of the camera up to this is no fault", "degrees", ge=0, le=90)
    tolerance_m: float = setting("a translation of the camera up to this is no fault", "m", ge=0, le=10)
    tolerance_delay_s: float = setting("a delay of the pictures up to this is no fault", "s", ge=0, le=10)
    fault_deg: float = setting(
        "rotation error of a camera for which the check says whether it would find it", "degrees", gt=0, le=90
    )
    fault_m: float = setting(
        "translation error of a camera for which the check says whether it would find it", "m", gt=0, le=10
    )
    fault_delay_s: float = setting(
        "delay of the pictures for which the check says whether it would find it", "s", gt=0, le=10
    )
    gain_sigmas: float = setting(
        "standard deviations by which pictures agree better with a fault than with the nearest tolerable offset",
        ge=0,
        le=100,
    )
    fault_sigmas: float = setting(
        "standard deviations between an offset and the tolerance from which it is a fault", ge=0, le=100
    )
    detection_sigmas: float = setting(
        "standard deviations beyond fault_sigmas at which a fault would be detected for sure", ge=0, le=100
    )
    max_focal_px: float = setting(
        "larger pictures are reduced to about this focal length", "px", ge=10, le=1e5
    )
    rotation_blur_deg: tuple[float, ...] = setting(
        "blur of the edges in each round that estimates the rotation alone, coarse to fine",
        "degrees",
        gt=0,
        le=20,
    )
    pose_blur_deg: tuple[float, ...] = setting(
        "blur of the edges in each round that estimates rotation and translation, coarse to fine",
        "degrees",
        gt=0,
        le=20,
    )
    prior_deg: float = setting("standard deviation of the prior on each rotation", "degrees", gt=0, le=90)
    prior_m: float = setting("standard deviation of the prior on each translation", "m", gt=0, le=10)
    prior_delay_s: float = setting("standard deviation of the prior on the delay", "s", gt=0, le=10)
    max_delay_s: float = setting("delays of the pictures up to this are looked for", "s", gt=0, le=10)
    delay_step_s: float = setting("step between the delays that are tried", "s", gt=0, le=10)
    prior_weight: float = setting("weight of the prior beside the mean edge strength", ge=0, le=1000)
    min_outlines: int = setting("fewest outline points from which an offset is estimated", ge=1, le=10**6)
    max_outlines: int = setting("outline points that are used, at most", ge=100, le=10**6)
    strips: int = setting("upright strips of the picture whose errors are independent", ge=1, le=1000)
    spans: int = setting("spans of time whose errors are independent, at most", ge=1, le=1000)
    scene_change: float = setting(
        "median change of grey, of 255, from which a picture shows another scene", gt=0, le=255
    )
    column_offset_deg: float = setting(
        "how far all left or right outlines may lie off together: half a LiDAR column", "degrees", ge=0, le=20
    )
    row_offset_deg: float = setting(
        "how far all upper outlines may lie off together: half a LiDAR row", "degrees", ge=0, le=20
    )
    min_offset_px: float = setting("least common displacement of outlines", "px", ge=0, le=1000)
    edge_noise: float = setting("gradient of a plain surface by noise, of 255 a pixel", gt=0, le=255)
    outline: OutlineConfig = table("Outlines of near surfaces in a sweep.")


@dataclass(frozen=True)
class CameraAxesConfig(Config):
    """Which way a camera looks, roughly."""

    column_deg: float = setting("width of a cell of the range image", "degrees", gt=0, le=10)
    row_deg: float = setting("height of a cell of the range image", "degrees", gt=0, le=10)
    min_range_gap_m: float = setting("a far surface is farther by at least this range", "m", ge=0, le=100)
    min_range_gap_share: float = setting("a far surface is farther by at least this share", ge=0, le=1)
    same_surface_m: float = setting(
        "cells of one surface differ in range by less than this", "m", ge=0, le=100
    )
    focal_px: float = setting("pictures are reduced to about this focal length", "px", ge=10, le=1e5)
    blur_deg: float = setting("blur of the edges", "degrees", gt=0, le=20)
    search_deg: float = setting("a hypothesis may be off by about this", "degrees", ge=0, le=20)
    min_outlines: int = setting("fewest outlines in view", ge=1, le=10**6)
    max_outlines: int = setting("most outlines that are used", ge=1, le=10**6)
    pictures: int = setting("pictures of a camera that are looked at", ge=1, le=1000)
