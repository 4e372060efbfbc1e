"""Settings of the objectness of tracks."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadSetting


@dataclass(frozen=True)
class ObjectnessConfig(Config):
    """What the shape of a track is measured on. The shipped prior was fitted with these values."""

    max_frames: int = setting(
        "frames with the most points that a track is measured in, at most", ge=1, le=1000
    )
    max_points: int = setting(
        "points of one frame whose neighborhoods are measured, at most", ge=10, le=10**6
    )
    neighbors: int = setting("points of a neighborhood", ge=4, le=100)
    top_share: float = setting("share of the height that is the top of an object", gt=0, le=1)
    ring_m: tuple[float, ...] = setting(
        "inner and outer distance from a box between which other points are counted", "m", gt=0, le=20
    )
    ring_height_m: tuple[float, ...] = setting(
        "lowest and highest height over the ground of these other points", "m", ge=0, le=20
    )

    def __post_init__(self) -> None:
        for name in ("ring_m", "ring_height_m"):
            values = getattr(self, name)
            if len(values) != 2 or not values[0] < values[1]:
                raise BadSetting(f"amodal: objectness.{name} = {list(values)} must be two ascending numbers")
