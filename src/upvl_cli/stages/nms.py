"""Which boxes are the labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class NmsConfig(Config):
    """Settings of `nms`."""

    max_iou: float = setting("of two boxes that overlap more, seen from above, the worse goes", ge=0, le=1)
    min_volume_m3: float = setting("a smaller box is dropped", "m^3", ge=0, le=10**6)
    max_volume_m3: float = setting("a larger box is dropped", "m^3", ge=0.001, le=10**6)
    min_height_m: float = setting("a lower box is dropped", "m", ge=0, le=100)


def run(inputs: Inputs, config: NmsConfig) -> Iterator[AmodalRow]:
    """Drop boxes that overlap better ones, and boxes too small or too large for an object."""
    import numpy as np

    from upvl_cli.perception.labels.suppression import suppress, wrong_size
    from upvl_cli.stages.rows import select

    for row in inputs.table("amodal", AmodalRow):
        faults = wrong_size(
            row.boxes.to_rows(),
            min_volume_m3=config.min_volume_m3,
            max_volume_m3=config.max_volume_m3,
            min_height_m=config.min_height_m,
        )
        for reason, faulty in faults.items():
            inputs.count(f"boxes dropped: {reason}", faulty.sum())
        sound = np.flatnonzero(~np.logical_or.reduce([*faults.values()]))
        kept = sound[suppress(row.boxes[sound].to_rows(), row.score[sound], max_iou=config.max_iou)]
        inputs.count("boxes dropped: overlap a better one", len(sound) - len(kept))
        inputs.count("boxes kept", len(kept))
        yield select(row, kept)


STAGE = Stage(name="nms", run=run, config=NmsConfig, row=AmodalRow, reads=("amodal",))
