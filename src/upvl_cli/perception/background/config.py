"""Settings of the algorithms that complete the background state of points that no camera sees."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class PlaceMemoryConfig(Config):
    """The background state of a place, from the sweeps in which a camera saw it."""

    voxel_m: float = setting("side of the voxels in which places are stored", "m", ge=0.01, le=10)
    radius_m: float = setting(
        "a point takes the state of the nearest stored place within this distance", "m", ge=0.01, le=10
    )
    min_background_share: float = setting(
        "a place is background if at least this share of the points seen there is", ge=0, le=1
    )


@dataclass(frozen=True)
class ShapeClassifierConfig(Config):
    """The background state of a point, learned from the LiDAR shape of the points that a camera saw."""

    voxel_m: float = setting("side of the voxels whose shape is described", "m", ge=0.01, le=10)
    surface_radius_m: float = setting(
        "radius of the neighborhood that gives the local surface", "m", ge=0.01, le=10
    )
    column_m: float = setting("side of the upright columns that give the heights", "m", ge=0.01, le=10)
    column_radius_m: float = setting(
        "radius within which columns give the lowest and the highest height", "m", ge=0.01, le=10
    )
    min_background_share: float = setting(
        "a voxel teaches background if at least this share of its seen points is", ge=0, le=1
    )
    max_samples: int = setting("voxels of a drive that the classifier is trained on, at most", ge=1, le=10**8)
    min_samples_per_class: int = setting(
        "with fewer voxels of background or of foreground no classifier is trained", ge=1, le=10**8
    )
    iterations: int = setting("trees of the gradient-boosted classifier", ge=1, le=10**5)
