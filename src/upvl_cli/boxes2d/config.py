"""Settings of detectors that run here."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting


@dataclass(frozen=True)
class SuppressionConfig(Config):
    """Where a detector of `onnx:` looks in a picture, and which of its boxes are kept."""

    tile_scales: tuple[float, ...] = setting(
        "scales of the picture at which tiles of the network's input size are cut, beside the entire picture "
        "reduced to that size: 1 is native, 2 enlarges, for smaller objects; an empty list cuts none",
        ge=0.1,
        le=8,
    )
    tile_overlap: float = setting(
        "overlap of neighboring tiles as a share of their side; what is cut by a tile's edge is left to the next tile",
        ge=0,
        le=0.9,
    )
    max_iou: float = setting(
        "IoU of two boxes of one kind above which the one of the lower score is dropped", ge=0, le=1
    )
