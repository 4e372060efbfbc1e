"""What a user corrects in what the drives say of themselves: the table `[corrections]` of `stages/raw.toml`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class CorrectionsConfig(Config):
    """Corrections of what drives say; each may be left out, and then the drive is believed.

    They are applied in the order of their declaration. `upvl check` names the line that mends what it finds.
    """

    drives: tuple[str, ...] = setting(
        "names of the drives that are corrected; * stands for any letters", default=("*",)
    )
    metres_per_unit: float = setting(
        "length of the unit in which the points are given", "m", gt=0, le=1e6, default=1.0
    )
    axes: tuple[str, ...] = setting(
        "the ego axes forward, left and up in terms of the axes in which the points are given: the letters x, y and "
        "z, each once, with - before one that points the other way",
        default=("x", "y", "z"),
    )
    intensity_full: float = setting(
        "intensity that counts as 1: 255 for values of eight bits", gt=0, le=1e12, default=1.0
    )
    car_m: tuple[float, ...] = setting(
        "the car itself in ego axes, from behind to ahead and from right to left, whose points are dropped; empty for "
        "none",
        "m",
        ge=-100,
        le=100,
        default=(),
    )
    ground_z_m: tuple[float, ...] = setting(
        "height of the road in ego axes; an empty list takes what the drive says or what its sweeps show",
        "m",
        ge=-100,
        le=100,
        default=(),
    )
    poses: Literal["world_from_ego", "ego_from_world", "ignored"] = setting(
        "which way the given poses go",
        effects={
            "world_from_ego": "from the axes of the car to those of the world, as upvl has them",
            "ego_from_world": "the other way; they are inverted",
            "ignored": "they are wrong: the drive is taken for one without poses, and odometry estimates them",
        },
        default="world_from_ego",
    )
    pose_metres_per_unit: float = setting(
        "length of the unit of the positions in the poses", "m", gt=0, le=1e6, default=1.0
    )
    pose_axes: tuple[str, ...] = setting(
        "the ego axes forward, left and up in terms of the car's axes that the poses are given for, as in axes",
        default=("x", "y", "z"),
    )
    pose_delay_s: float = setting(
        "how late the poses are: one that is given for a time is that of so much earlier",
        "s",
        ge=-10,
        le=10,
        default=0.0,
    )
    picture_delay_s: float = setting(
        "how much later than its time stamp each picture was taken", "s", ge=-10, le=10, default=0.0
    )
    motion_compensation: Literal["as-given", "apply", "undo"] = setting(
        "what is done about the motion of the car during a sweep",
        effects={
            "as-given": "nothing: the points are where the car saw them at the frame's time",
            "apply": "points that carry times are moved to the frame's time by the poses",
            "undo": "a compensation that was done twice is taken back once",
        },
        default="as-given",
    )
