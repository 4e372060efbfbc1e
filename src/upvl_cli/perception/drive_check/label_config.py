"""Settings of the checks of human labels."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class LabelCheckConfig(Config):
    """Whether labels fit the points and each other."""

    frames: int = setting("labelled frames that are looked at", ge=1, le=10**4)
    reach_m: float = setting("boxes up to this far from the car are compared with points", "m", gt=0, le=1000)
    inner_m: float = setting("points this far outside of a box still belong to it", "m", ge=0, le=10)
    outer_m: float = setting("points of an object lie no farther from its box than this", "m", gt=0, le=10)
    ground_cell_m: float = setting("cells in which the lowest point is the road", "m", gt=0, le=100)
    ground_m: float = setting("points up to this high above the road are road", "m", ge=0, le=10)
    min_points: int = setting("points around a box from which it is judged", ge=1, le=10**6)
    min_objects: int = setting("objects from which labels are judged", ge=2, le=10**6)
    better_share: float = setting(
        "another meaning of the labels puts at least this much more of the points inside", ge=0, le=1
    )
    better_sigmas: float = setting("standard deviations between objects by which it does so", ge=0, le=100)
    low_share: float = setting("less than this share of the points inside is suspicious", ge=0, le=1)
    min_speed_mps: float = setting(
        "objects that move at least this fast show a direction", "m/s", gt=0, le=100
    )
    max_speed_mps: float = setting("no object moves faster", "m/s", gt=0, le=1000)
    many: float = setting("share of objects or steps from which on a contradiction is a warning", gt=0, le=1)
