"""PROVISIONAL."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.rows import LabelRow
from upvl_cli.stage import Stage, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs


@dataclass(frozen=True)
class AmodalParams:
    """Settings of `amodal`."""

    size_share: float = param("PROVISIONAL", above=0, most=1)


def run(inputs: Inputs, params: AmodalParams) -> Iterator[LabelRow]:
    """Give every track one size, and place that box in each of its frames."""
    import numpy as np

    for row in inputs.table("track"):
        yield LabelRow(
            inputs.segment,
            row.frame,
            row.seven,
            row.velocity_mps,
            row.points,
            score=np.minimum(row.points / 200, 1.0),
            track_id=row.track_id,
        )


STAGE = Stage(
    name="amodal", run=run, params=AmodalParams, row=LabelRow, reads=("raw", "odometry", "propose", "track")
)
