"""Which points are the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import GroundRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Frame


@dataclass(frozen=True)
class GroundConfig(Config):
    """Settings of `ground`."""

    cell_m: float = setting("edge of the cells of the ground map", "m", ge=0.1, le=20)
    max_slope: float = setting("steepest ground, as rise over run", ge=0.001, le=10)
    tolerance_m: float = setting("ground may lie this far above the map's planes", "m", ge=0.001, le=10)
    max_height_m: float = setting("points up to this height above the map are ground", "m", ge=0, le=20)


def run(inputs: Inputs, config: GroundConfig) -> Iterator[GroundRow]:
    """Find the ground below every sweep, and how high above it each point is."""
    from upvl_cli.perception.ground import height_above_ground
    from upvl_cli.runtime.parallel import in_order

    drive = inputs.drive

    def height_m(frame: Frame) -> Array:
        return height_above_ground(
            drive.points(frame.index).xyz_ego_m,
            start_z_m=drive.ground_z_m,
            cell_m=config.cell_m,
            max_slope=config.max_slope,
            tolerance_m=config.tolerance_m,
        )

    for frame, heights_m in zip(drive.frames, in_order(height_m, drive.frames), strict=True):
        is_ground = heights_m <= config.max_height_m
        inputs.count("ground points", is_ground.sum())
        inputs.count("points above ground", (~is_ground).sum())
        yield GroundRow(inputs.segment, frame.index, heights_m, is_ground)


STAGE = Stage(name="ground", run=run, config=GroundConfig, row=GroundRow, reads=("raw",))
