"""Settings of the scores and the sizes of labels."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class SupportScoreConfig(Config):
    """Settings of `suppression.support_score`."""

    half_points: float = setting(
        "number of points in a box at which the support by points is one half", gt=0, le=10**6
    )
    half_frames: float = setting(
        "number of frames with points of a track at which the support by frames is one half", gt=0, le=10**6
    )


@dataclass(frozen=True)
class SizeConfig(Config):
    """Settings of `suppression.size_faults`. There is no limit on length: buses and trams are long."""

    min_volume_m3: float = setting("volume below which a box is dropped", "m^3", ge=0, le=10**6)
    max_volume_m3: float = setting("volume above which a box is dropped", "m^3", ge=0.001, le=10**6)
    min_height_m: float = setting("height below which a box is dropped", "m", ge=0, le=100)
