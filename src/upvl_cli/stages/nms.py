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
class NmsParams:
    """Settings of `nms`."""

    max_iou: float = param(
        "of two boxes that overlap more, the one of lower score is dropped", least=0, most=1
    )


def run(inputs: Inputs, params: NmsParams) -> Iterator[LabelRow]:
    """Drop boxes that overlap better ones, and boxes too small or too large for an object."""
    yield from inputs.table("amodal")


STAGE = Stage(name="nms", run=run, params=NmsParams, row=LabelRow, reads=("amodal",))
