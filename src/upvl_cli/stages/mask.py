"""Which points move, and which are background."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class MaskParams:
    """Settings of `mask`."""

    min_speed_mps: float = param(
        "a point moves from this speed on: the paper's eps_sf", "m/s", least=0, most=200
    )


@dataclass(frozen=True)
class MaskRow(Row):
    """State of each point of a sweep, in the order of its points."""

    is_moving: Array = column("bool", "faster than min_speed_mps", per="point")
    background: Array = column(
        "int8",
        "1 looks like background, 0 does not, -1 unknown: it has no vision-language feature",
        per="point",
    )


def run(inputs: Inputs, params: MaskParams) -> Iterator[MaskRow]:
    """Mark the points that move, by speed; no point has a vision-language feature yet."""
    from upvl_cli.algorithms.masks import moving, unknown_background

    for row in inputs.table("flow"):
        is_moving = moving(row.flow_mps, min_speed_mps=params.min_speed_mps)
        inputs.count("points moving", is_moving.sum())
        inputs.count("points still", (~is_moving).sum())
        yield MaskRow(inputs.segment, row.frame, is_moving, unknown_background(len(is_moving)))


STAGE = Stage(name="mask", run=run, params=MaskParams, row=MaskRow, reads=("flow",))
