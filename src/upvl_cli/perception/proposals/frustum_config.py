"""Settings of objects that 2D boxes show."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class FrustumConfig(Config):
    """Which 2D boxes become objects, and which of the points behind them are theirs."""

    kinds: tuple[str, ...] = setting(
        "names of the kinds of 2D boxes that become objects; a person on a bicycle or motorcycle is one box, a cyclist "
        "or motorcyclist"
    )
    min_score: float = setting("lowest confidence of a 2D box that becomes an object", ge=0, le=1)
    min_points: int = setting("smallest number of points of an object", ge=1, le=10**6)
    max_gap_m: float = setting(
        "gap in depth, seen from the camera, that parts an object from what is before and behind it",
        "m",
        ge=0.01,
        le=20,
    )
    max_depth_m: float = setting("largest extent of an object in depth", "m", ge=0.1, le=50)
    middle_share: float = setting(
        "part of the width of a 2D box, in its middle, in which the object fills most of the view", gt=0, le=1
    )
    min_filled: float = setting(
        "smallest share of the points in the middle of a 2D box that an object has", ge=0, le=1
    )
    min_height_m: float = setting("smallest height of a 2D box at the depth of its object", "m", ge=0, le=100)
    max_height_m: float = setting("largest height of a 2D box at the depth of its object", "m", ge=0, le=100)
    min_shared: float = setting(
        "share of an object's points in a cluster, and of the cluster's points behind the 2D box, from which on both "
        "are the same object",
        gt=0,
        le=1,
    )
    max_claimed: float = setting(
        "largest share of an object's points that an object of a better 2D box has too", ge=0, le=1
    )
