"""Which points are the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array, Frame


@dataclass(frozen=True)
class GroundParams:
    """Settings of `ground`."""

    cell_m: float = param("edge of the cells of the ground map", "m", least=0.1, most=20)
    max_slope: float = param("steepest ground, as rise over run", least=0.001, most=10)
    tolerance_m: float = param("ground may lie this far above the map's planes", "m", least=0.001, most=10)
    max_height_m: float = param("points up to this height above the map are ground", "m", least=0, most=20)


@dataclass(frozen=True)
class GroundRow(Row):
    """Height of each point of a sweep, in the order of its points."""

    height_m: Array = column("float16", "height above the ground below the point", "m", per="point")
    is_ground: Array = column("bool", "part of the ground", per="point")


def run(inputs: Inputs, params: GroundParams) -> Iterator[GroundRow]:
    """Find the ground below every sweep, and how high above it each point is."""
    from upvl_cli.algorithms.ground import height_above_ground
    from upvl_cli.parallel import in_order

    drive = inputs.drive

    def height_m(frame: Frame) -> Array:
        return height_above_ground(
            drive.points(frame.index).xyz_ego_m,
            start_z_m=drive.ground_z_m,
            cell_m=params.cell_m,
            max_slope=params.max_slope,
            tolerance_m=params.tolerance_m,
        )

    for frame, heights_m in zip(drive.frames, in_order(height_m, drive.frames), strict=True):
        is_ground = heights_m <= params.max_height_m
        inputs.count("ground points", is_ground.sum())
        inputs.count("points above ground", (~is_ground).sum())
        yield GroundRow(inputs.segment, frame.index, heights_m, is_ground)


STAGE = Stage(name="ground", run=run, params=GroundParams, row=GroundRow, reads=("raw",))
