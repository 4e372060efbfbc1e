"""Settings of the sensor card."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class SensorConfig(Config):
    """How the sensors of a drive are measured."""

    origin_points: int = setting(
        "points of a sweep by which the place of a LiDAR on the car is searched", ge=100, le=10**6
    )
    beam_sweeps: int = setting("sweeps by which the beams of a LiDAR are counted", ge=1, le=1000)
    min_beam_contrast: float = setting(
        "how much more elevations gather at some angles than evenly; with less the beams cannot be told",
        ge=1,
        le=100,
    )
    near_m: float = setting(
        "points nearer to a LiDAR show no beam and no road: the car lies there", "m", ge=0, le=10
    )
    car_reach_m: float = setting(
        "points of the car itself lie within this distance before or behind the origin of the ego axes",
        "m",
        gt=0,
        le=50,
    )
    car_half_width_m: float = setting(
        "points of the car itself lie within this distance to each side of the ego axes: walls along the road, which "
        "stay where they are too, lie farther",
        "m",
        gt=0,
        le=10,
    )
    car_cell_m: float = setting(
        "edge of the cells in which points of the car itself are looked for", "m", gt=0, le=2
    )
    car_share: float = setting(
        "a cell that has points in at least this share of the sweeps, while all else changes, is of the car itself",
        gt=0,
        le=1,
    )
    min_car_points: int = setting(
        "fewest points of a sweep on the car itself that are reported", ge=1, le=10**6
    )
    sector_deg: float = setting(
        "width of the directions in which a LiDAR sees something or nothing", "degrees", gt=0, le=90
    )
    person_width_m: float = setting("width of the pedestrian whose points are counted", "m", gt=0, le=10)
    person_height_m: float = setting("height of that pedestrian", "m", gt=0, le=10)
    person_points: int = setting(
        "points that a pedestrian needs: `clustering.min_points` of propose.toml", ge=1, le=10**6
    )
    min_rate_hz: float = setting(
        "sweeps a second below which the card says what the rate cannot give", "Hz", gt=0, le=1000
    )
    max_rate_hz: float = setting(
        "sweeps a second above which the card says what the rate cannot give", "Hz", gt=0, le=10**4
    )
