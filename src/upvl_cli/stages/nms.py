"""Which boxes are the labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.labels.config import SizeConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Floats


@dataclass(frozen=True)
class NmsConfig(Config):
    """Settings of `nms`."""

    max_iou: float = setting(
        "bird's-eye IoU of two boxes above which the one of the lower score is dropped", ge=0, le=1
    )
    min_objectness: float = setting(
        "likeness of a track to road users below which its boxes are dropped", ge=0, le=1
    )
    size: SizeConfig = table("sizes that an object can have")


def run(inputs: Inputs, config: NmsConfig) -> Iterator[AmodalRow]:
    """Drop boxes that overlap better ones, and boxes too small or too large for an object."""
    import numpy as np

    from upvl_cli.geometry.nms import nms_bev
    from upvl_cli.perception.labels.suppression import size_faults
    from upvl_cli.stages.rows import select

    for row in inputs.table("amodal", AmodalRow):
        faults = size_faults(row.boxes, config.size)
        for reason, is_faulty in faults.items():
            inputs.count(f"boxes dropped: {reason}", is_faulty.sum())
        is_sound = ~np.logical_or.reduce([*faults.values()])
        is_alike = row.objectness >= config.min_objectness
        inputs.count("boxes dropped: unlike a road user", (is_sound & ~is_alike).sum())
        sound = np.flatnonzero(is_sound & is_alike)
        best = nms_bev(row.boxes[sound], _preference(row)[sound], max_iou=config.max_iou)
        kept = sound[np.sort(best)]
        inputs.count("boxes dropped: overlap a better one", len(sound) - len(kept))
        inputs.count("boxes kept", len(kept))
        yield select(row, kept)


def _preference(row: AmodalRow) -> Floats:
    """Return (n,) an order of the boxes that is the same in all frames: of two tracks of one object one stays."""
    import numpy as np

    order = np.lexsort((-row.track_id, row.num_frames_seen, row.objectness * (1 - row.background_share)))
    rank = np.empty(len(order))
    rank[order] = np.arange(len(order))
    return rank


STAGE = Stage(name="nms", run=run, config=NmsConfig, row=AmodalRow, reads=("amodal",), version=2)
