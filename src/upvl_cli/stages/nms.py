"""Which boxes are the labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.rows import LabelRow
from upvl_cli.stage import Stage, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs


@dataclass(frozen=True)
class NmsParams:
    """Settings of `nms`."""

    max_iou: float = param("of two boxes that overlap more, seen from above, the worse goes", least=0, most=1)
    min_volume_m3: float = param("a smaller box is dropped", "m^3", least=0, most=10**6)
    max_volume_m3: float = param("a larger box is dropped", "m^3", least=0.001, most=10**6)
    min_height_m: float = param("a lower box is dropped", "m", least=0, most=100)


def run(inputs: Inputs, params: NmsParams) -> Iterator[LabelRow]:
    """Drop boxes that overlap better ones, and boxes too small or too large for an object."""
    import numpy as np

    from upvl_cli.algorithms.suppression import suppress, wrong_size

    for row in inputs.table("amodal"):
        faults = wrong_size(
            row.seven,
            min_volume_m3=params.min_volume_m3,
            max_volume_m3=params.max_volume_m3,
            min_height_m=params.min_height_m,
        )
        for reason, faulty in faults.items():
            inputs.count(f"boxes dropped: {reason}", faulty.sum())
        sound = np.flatnonzero(~np.logical_or.reduce([*faults.values()]))
        kept = sound[suppress(row.seven[sound], row.score[sound], max_iou=params.max_iou)]
        inputs.count("boxes dropped: overlap a better one", len(sound) - len(kept))
        inputs.count("boxes kept", len(kept))
        yield LabelRow(
            inputs.segment,
            row.frame,
            row.seven[kept],
            row.velocity_mps[kept],
            row.points[kept],
            row.score[kept],
            row.track_id[kept],
        )


STAGE = Stage(name="nms", run=run, params=NmsParams, row=LabelRow, reads=("amodal",))
