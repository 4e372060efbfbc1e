"""Settings of odometry; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class KissIcpConfig(Config):
    """Settings of KISS-ICP."""

    voxel_m: float = setting("edge of the voxels of the local map", "m", ge=0.01, le=10)
    min_range_m: float = setting(
        "points nearer than this are left out: they are the car itself", "m", ge=0, le=1000
    )
    max_range_m: float = setting("points farther than this are left out", "m", ge=1, le=1000)
    initial_threshold_m: float = setting(
        "deviation from the constant-velocity prediction that is expected at the start", "m", ge=0.01, le=100
    )
    convergence_m: float = setting(
        "registration has converged once a step is shorter than this (KISS-ICP's convergence criterion)",
        "m",
        gt=0,
        le=1,
    )


@dataclass(frozen=True)
class StructureConfig(Config):
    """Settings of upright structure, by which motions are searched and judged."""

    range_m: float = setting("half the side of the square of the ground plan that is used", "m", ge=5, le=500)
    cell_m: float = setting("cell of the ground plan in which heights are compared", "m", ge=0.1, le=10)
    min_height_m: float = setting("a cell with points so far above each other is upright", "m", ge=0.1, le=10)
    ground_clearance_m: float = setting(
        "points of a cell less than this above its lowest point are taken for the ground", "m", ge=0, le=5
    )
    voxel_m: float = setting("edge of the voxels of which one point each is kept", "m", ge=0.01, le=5)


@dataclass(frozen=True)
class AgreementConfig(Config):
    """Settings of how the agreement of two sweeps is measured."""

    partner_m: float = setting(
        "distance within which a point of the other sweep counts as a partner", "m", ge=0.01, le=5
    )
    points: int = setting("upright points of a sweep that are compared at most", ge=50, le=1000000)


@dataclass(frozen=True)
class SearchConfig(Config):
    """Settings of the search of a motion without a guess."""

    sweeps: int = setting("first sweeps over which each start is tried and judged", ge=2, le=100)
    candidates: int = setting("starts that are tried at most, beside the predicted one", ge=1, le=100)
    cell_m: float = setting("cell of the ground plans that are correlated", "m", ge=0.1, le=5)
    range_m: float = setting("half the side of the square that is correlated", "m", ge=5, le=500)
    yaw_step_rad: float = setting("step of the turns that are tried", "rad", ge=0.001, le=0.5)
    apart_m: float = setting("two starts differ by more than this", "m", ge=0.1, le=20)
    max_speed_mps: float = setting("no start is faster than this", "m/s", ge=1, le=150)
    max_turn_radps: float = setting("no start turns faster than this", "rad/s", ge=0.01, le=10)
    max_shift_m: float = setting("farthest shift between two sweeps that is tried", "m", ge=1, le=200)
    max_turn_rad: float = setting("largest turn between two sweeps that is tried", "rad", ge=0.01, le=3.1416)
    preference: float = setting(
        "share by which a start at max_speed_mps has to fit better than one that stands", ge=0, le=1
    )


@dataclass(frozen=True)
class PlacementConfig(Config):
    """Settings of which registrations are believed."""

    min_inlier_share: float = setting(
        "share of upright points with a partner in the sweep before below which a frame is not placed",
        ge=0,
        le=1,
    )
    usual_share: float = setting(
        "a registration with less than this part of the usual share of partners is searched anew", ge=0, le=1
    )
    max_acceleration_mps2: float = setting(
        "no car speeds up, brakes or swerves more than this", "m/s²", gt=0, le=100
    )
    max_yaw_acceleration_radps2: float = setting(
        "no car's turn rate changes faster than this", "rad/s²", gt=0, le=100
    )
    tolerance_m: float = setting("error of a registration that is no acceleration", "m", ge=0, le=10)
    tolerance_rad: float = setting("error of a registration that is no turn", "rad", ge=0, le=1)
    give_up_s: float = setting(
        "time without a placed frame after which a new start is searched", "s", ge=0.1, le=1000
    )


@dataclass(frozen=True)
class AlignmentConfig(Config):
    """Settings of the alignment of upright things, which corrects the registration to the map."""

    registration_sigma_m: float = setting(
        "standard deviation of the registration to the map, beside the alignment's own", "m", gt=0, le=10
    )
    young_sweeps: int = setting(
        "a map of fewer sweeps does not count beside the alignment: rings of the road pull it to no motion",
        ge=0,
        le=1000,
    )
    reference_m: float = setting(
        "sweeps are aligned with the same one until the car is so far away", "m", ge=0, le=100
    )
    reference_rad: float = setting("or has turned by this", "rad", ge=0, le=3.1416)
    reference_s: float = setting("or so long has passed", "s", ge=0, le=100)


@dataclass(frozen=True)
class PathSmoothingConfig(Config):
    """Settings of the smoothing of an estimated path."""

    method: Literal["none", "local-polynomial"] = setting(
        "how estimated positions are smoothed; none: not at all; local-polynomial: local regression over time"
    )
    half_window_s: float = setting(
        "time to each side that takes part in a local polynomial", "s", gt=0, le=1000
    )
    degree: int = setting("degree of the local polynomial", ge=1, le=5)


@dataclass(frozen=True)
class LidarOdometryConfig(Config):
    """Settings of the estimate of poses from sweeps."""

    kiss_icp: KissIcpConfig = table("registration to a local map by KISS-ICP")
    structure: StructureConfig = table("upright structure, by which motions are searched and judged")
    agreement: AgreementConfig = table("how the agreement of two sweeps is measured")
    alignment: AlignmentConfig = table("alignment of upright things, beside the registration")
    search: SearchConfig = table("search of a motion without a guess: at the start, after a gap or a bad fit")
    placement: PlacementConfig = table("which registrations are believed")


@dataclass(frozen=True)
class RefinementConfig(Config):
    """Settings of the refinement of given poses."""

    averaging_s: float = setting("time over which errors of the given poses are averaged", "s", gt=0, le=1000)
    max_drift_share: float = setting(
        "part of the path by which odometry drifts at most: given poses that are off by more have another shape",
        ge=0,
        le=1,
    )
    max_drift_mps: float = setting("drift of the position at most, whatever the speed", "m/s", ge=0, le=10)
    max_turn_drift_radps: float = setting("drift of the rotation at most", "rad/s", ge=0, le=1)
