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


@dataclass(frozen=True)
class PictureScoreConfig(Config):
    """Settings of the scores of tracks that pictures show."""

    min_weight: float = setting(
        "factor of the score of a track in view of a camera that no 2D box overlaps in any frame; used where boxes2d "
        "has a detector",
        ge=0,
        le=1,
    )
    full_iou: float = setting(
        "IoU with 2D boxes, averaged over the frames of a track in view, from which on its score is kept; below it the "
        "factor falls in a straight line",
        gt=0,
        le=1,
    )
