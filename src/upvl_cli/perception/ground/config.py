"""Settings of the ground map; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class GroundMapConfig(Config):
    """Settings of the map of ground heights below one sweep."""

    cell_m: float = setting("edge of the cells of the ground map", "m", ge=0.1, le=20)
    half_extent_m: float = setting(
        "reach of the ground map from the car in x and y; farther points take the height at its rim",
        "m",
        ge=5,
        le=1000,
    )
    max_slope: float = setting("steepest ground, as rise over run", ge=0.001, le=10)
    tolerance_m: float = setting(
        "height above a smooth surface up to which the lowest point of a cell is ground", "m", ge=0.001, le=10
    )
    blind_radius_m: float = setting(
        "distance from the car within which empty cells take the height of the road below the sensor",
        "m",
        ge=0,
        le=100,
    )
    prior_tolerance_m: float = setting(
        "difference from the height of the road below the sensor that ground may have at the car",
        "m",
        ge=0,
        le=100,
    )
    prior_slope: float = setting(
        "further difference that ground may have for each metre of distance from the car", ge=0, le=10
    )
    support_radius_cells: int = setting(
        "neighboring cells to each side whose lowest points must agree with that of a cell", ge=1, le=50
    )
    min_support_share: float = setting(
        "share of the known cells around a cell, itself included, that must agree with its lowest point",
        ge=0,
        le=1,
    )
    min_support_cells: int = setting(
        "number of cells around a cell, itself included, that must agree with its lowest point",
        ge=1,
        le=10**4,
    )
    envelope_reach_cells: int = setting(
        "cells over which the lower envelope carries the ground below objects", ge=0, le=1000
    )
    obstacle_min_height_m: float = setting(
        "height above a cell's lowest point from which a point marks the cell as occupied by an obstacle",
        "m",
        ge=0,
        le=20,
    )
    obstacle_max_height_m: float = setting(
        "height above a cell's lowest point up to which a point marks the cell as occupied by an obstacle",
        "m",
        ge=0,
        le=100,
    )
    window_cells: tuple[int, ...] = setting(
        "edges of the windows, in cells, that a plane is fitted in; the smallest one with enough ground is used",
        ge=1,
        le=10**4,
    )
    min_window_cells: int = setting("ground cells that a window needs for its plane", ge=1, le=10**4)
    refinements: int = setting(
        "times that the planes are fitted anew to what does not lie above them", ge=0, le=100
    )
    refined_tolerance_m: float = setting(
        "height above the planes from which a lowest point is left out then", "m", gt=0, le=10
    )
    max_depth_m: float = setting(
        "depth below the first plane beyond which a lowest point is a mirror image and no ground",
        "m",
        gt=0,
        le=100,
    )
