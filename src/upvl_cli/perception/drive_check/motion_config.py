"""Settings of the checks of motion; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class UprightStructureConfig(Config):
    """What of a sweep stands upright above the road: the part that shows how the car moves."""

    typical_range_m: float = setting(
        "median range of a sweep in a street, by which unknown units of points are guessed roughly",
        "m",
        gt=0,
        le=500,
    )
    min_range_m: float = setting(
        "points nearer than this are left out: they are the car itself", "m", ge=0, le=100
    )
    max_range_m: float = setting("points farther than this are left out", "m", ge=1, le=500)
    cell_m: float = setting("edge of the cells in which the road is the lowest surface", "m", gt=0, le=20)
    road_quantile: float = setting("quantile of the heights in a cell that is taken for the road", ge=0, le=1)
    min_height_m: float = setting("points lower than this above the road are left out", "m", ge=0, le=10)
    voxel_m: float = setting("edge of the voxels that points are thinned by", "m", gt=0, le=5)
    max_points: int = setting("most voxels of a sweep that are registered", ge=10, le=10**6)


@dataclass(frozen=True)
class RegisterConfig(Config):
    """Motion between two sweeps, from the sweeps alone."""

    max_speed_mps: float = setting("fastest car that is looked for", "m/s", gt=0, le=200)
    max_turn_rate_radps: float = setting("fastest turn that is looked for", "rad/s", gt=0, le=10)
    coarse_cell_m: float = setting("edge of the cells of the search for the first guess", "m", gt=0, le=10)
    coarse_yaw_rad: float = setting("steps of yaw of the search for the first guess", "rad", gt=0, le=1)
    start_offsets_m: tuple[float, ...] = setting(
        "shifts in x and in y of the first guess from which the best start is chosen", "m", ge=-10, le=10
    )
    starts: int = setting("best starts that ICP is run from", ge=1, le=1000)
    start_points: int = setting("voxels that starts are compared by", ge=10, le=10**6)
    radius_m: tuple[float, ...] = setting(
        "correspondence radius of each round of ICP, coarse to fine", "m", gt=0, le=20
    )
    iterations: int = setting("steps of each round of ICP", ge=1, le=1000)
    neighbors: int = setting("voxels that the normal of a surface is fitted to", ge=3, le=1000)
    noise_m: float = setting("standard deviation of a point from the surface it lies on", "m", gt=0, le=1)
    sectors: int = setting("sectors around the car whose errors are independent", ge=3, le=360)
    min_inlier_share: float = setting(
        "share of voxels with a partner below which sweeps cannot be compared", ge=0, le=1
    )
    max_sigma_m: float = setting(
        "standard deviation of a motion above which sweeps cannot be compared", "m", gt=0, le=10
    )


@dataclass(frozen=True)
class RoadConfig(Config):
    """The plane of the road around the car, when no axis is believed."""

    radius_m: float = setting("the road is looked for up to this far from the car", "m", gt=0, le=500)
    cell_m: float = setting(
        "edge of the cells whose low points are candidates for the road", "m", gt=0, le=20
    )
    tolerance_m: float = setting(
        "a low point nearer to the plane than this lies on the road", "m", gt=0, le=5
    )
    clear_height_m: float = setting(
        "points farther from the plane than this are above or below the road", "m", gt=0, le=10
    )
    max_points: int = setting("most points of a sweep that are looked at", ge=100, le=10**7)
    min_cells: int = setting("fewest cells of a road", ge=4, le=10**6)
    max_slope: float = setting("steepest plane, against the axis nearest to up, that is a road", gt=0, le=1)


@dataclass(frozen=True)
class MotionLimitsConfig(Config):
    """From where on a motion is wrong."""

    tolerance_m: float = setting("error of a step that is no fault", "m", gt=0, le=10)
    tolerance_share: float = setting("error of a step that is no fault, as a share of the step", gt=0, le=1)
    tolerance_rad: float = setting("error of the yaw of a step that is no fault", "rad", gt=0, le=1)
    roughness_mps: float = setting(
        "error of the velocity, after smoothing, above which poses are rough", "m/s", gt=0, le=100
    )
    smoothing_s: float = setting("half of the window by which positions are smoothed", "s", ge=0, le=10)
    min_agreeing_share: float = setting("share of pairs of sweeps that right poses explain", ge=0, le=1)
    max_gap_s: float = setting("sweeps farther apart in time are not compared", "s", gt=0, le=10)
    min_speed_mps: float = setting("a slower car stands: its motion shows no axes", "m/s", gt=0, le=10)
    max_axis_error_rad: float = setting(
        "angle between an axis and the motion or the road above which the axes are wrong", "rad", gt=0, le=0.8
    )
    max_speed_mps: float = setting("fastest car", "m/s", gt=0, le=1000)
    max_acceleration_mps2: float = setting("fastest change of speed of a car", "m/s2", gt=0, le=1000)
    max_turn_rate_radps: float = setting("fastest turn of a car", "rad/s", gt=0, le=100)
    max_tilt_rad: float = setting("steepest roll or pitch of a car", "rad", gt=0, le=1.6)
    max_delay_s: float = setting("longest delay of poses that is looked for", "s", ge=0, le=10)
    min_delay_s: float = setting("delay of poses that is no fault", "s", gt=0, le=1)
    sigmas: float = setting("standard deviations from which a small error is certain", gt=0, le=100)


@dataclass(frozen=True)
class CompensationConfig(Config):
    """Motion compensation of the points."""

    min_speed_mps: float = setting("a slower car does not show it", "m/s", gt=0, le=100)
    min_spread_s: float = setting("times of points that spread less say nothing", "s", gt=0, le=1)
    distance_m: float = setting("way of the car between the sweeps that are compared", "m", gt=0, le=100)
    max_gap_s: float = setting("longest time between the sweeps that are compared", "s", gt=0, le=60)
    pairs: int = setting("pairs of sweeps that are compared, at most", ge=3, le=1000)
    tolerance: float = setting("share of the motion compensation that may be missing", ge=0, le=1)
    sigmas: float = setting("standard deviations within which the share fits a state", gt=0, le=100)


@dataclass(frozen=True)
class MotionCheckConfig(Config):
    """Checks of poses, axes and motion compensation by the sweeps themselves."""

    road: RoadConfig = table("The plane of the road.")
    structure: UprightStructureConfig = table("What stands above the road.")
    registration: RegisterConfig = table("Motion between two sweeps.")
    compensation: CompensationConfig = table("Motion compensation of the points.")
    limits: MotionLimitsConfig = table("From where on a motion is wrong.")
