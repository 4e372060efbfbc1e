"""Which points are the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.ground.config import GroundMapConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import GroundRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Frame


@dataclass(frozen=True)
class GroundConfig(Config):
    """Settings of `ground`."""

    max_height_m: float = setting(
        "height above the ground map up to which a point belongs to the ground", "m", ge=0, le=20
    )
    map: GroundMapConfig = table("map of ground heights below a sweep")


def run(inputs: Inputs, config: GroundConfig) -> Iterator[GroundRow]:
    """Find the ground below every sweep, and how high above it each point is."""
    from upvl_cli.perception.ground.height import height_above_ground
    from upvl_cli.runtime.parallel import in_order

    drive = inputs.drive

    def height_m(frame: Frame) -> Array:
        return height_above_ground(drive.points(frame.index).xyz_ego_m, drive.ground_z_m, config.map)

    for frame, heights_m in zip(drive.frames, in_order(height_m, drive.frames), strict=True):
        is_ground = heights_m <= config.max_height_m
        inputs.count("ground points", is_ground.sum())
        inputs.count("points above ground", (~is_ground).sum())
        yield GroundRow(inputs.segment, frame.index, heights_m, is_ground)


STAGE = Stage(name="ground", run=run, config=GroundConfig, row=GroundRow, reads=("raw",))
