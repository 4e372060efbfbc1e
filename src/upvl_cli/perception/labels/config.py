"""Settings of the scores, the sizes and the looks of labels."""

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
class LookChoiceConfig(Config):
    """Settings of `looks.choose_looks`."""

    looks_per_track: int = setting("most pictures that a track is looked at in", ge=1, le=1000)
    min_gap_s: float = setting("least time between two looks at a track by the same camera", "s", ge=0, le=60)
    min_px: float = setting(
        "an object whose longer side is shorter than this in a picture is not looked at", "px", ge=1, le=1000
    )


@dataclass(frozen=True)
class LookCropConfig(Config):
    """Settings of `look_crops.cut`."""

    context: float = setting(
        "what is added on each side of an object, as a share of its longer side", ge=0, le=5
    )
    max_px: int = setting("a part of a picture with a longer side is reduced", "px", ge=16, le=4096)
    wanted_px: int = setting(
        "a part whose longer side fits into this several times is enlarged so many times", "px", ge=0, le=4096
    )


@dataclass(frozen=True)
class LookVoteConfig(Config):
    """Settings of `look_votes`: how looks and points choose a word together."""

    temperature: float = setting(
        "temperature of the softmax over cosines that gives each word its share of a look", gt=0, le=1
    )
    weight: float = setting("weight of the looks where points vote too, theirs being 1 less this", ge=0, le=1)


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
