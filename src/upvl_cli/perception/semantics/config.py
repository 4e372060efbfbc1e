"""Settings of the fusion of words over a drive."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class FusionConfig(Config):
    """The scores of a standing point are those of its place, averaged over the sweeps in which a camera saw it."""

    voxel_m: float = setting(
        "side of the voxels in which the scores of places are added up", "m", ge=0.01, le=10
    )
    radius_m: float = setting(
        "a point takes the scores of the nearest stored place within this distance", "m", ge=0.01, le=10
    )
