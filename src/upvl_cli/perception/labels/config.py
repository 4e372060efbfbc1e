"""Settings of the scores and the sizes of labels."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class BoxScoreConfig(Config):
    """Settings of `suppression.box_score`."""

    half_points: float = setting("points of a box at which its support is one half", ge=0, le=10**6)


@dataclass(frozen=True)
class SizeConfig(Config):
    """Settings of `suppression.size_faults`. There is no limit on length: buses and trams are long."""

    min_volume_m3: float = setting("volume below which a box is dropped", "m^3", ge=0, le=10**6)
    max_volume_m3: float = setting("volume above which a box is dropped", "m^3", ge=0.001, le=10**6)
    min_height_m: float = setting("height below which a box is dropped", "m", ge=0, le=100)
