"""Which points are the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.errors import BadSetting
from upvl_cli.perception.ground.config import GroundMapConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import GroundRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Frame


@dataclass(frozen=True)
class GroundConfig(Config):
    """Settings of `ground`."""

    method: Literal["estimate", "dataset"] = setting(
        "where the height of the ground comes from",
        effects={
            "estimate": "from each sweep alone, by the map below",
            "dataset": "from the height map of the data set where it has one (argoverse2), and from the sweep at "
            "places that the map does not know",
        },
    )
    max_height_m: float = setting(
        "height above the ground map up to which a point belongs to the ground", "m", ge=0, le=20
    )
    map: GroundMapConfig = table("map of ground heights below a sweep")


def run(inputs: Inputs, config: GroundConfig) -> Iterator[GroundRow]:
    """Find the ground below every sweep, and how high above it each point is."""
    from upvl_cli.perception.ground.height import height_above_ground, height_above_known_ground
    from upvl_cli.perception.ground.source import GroundSource, IncompleteSweeps
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    drive = inputs.drive
    points_of = compensated_points(drive, inputs.table("odometry", OdometryRow))
    source = drive if config.method == "dataset" and isinstance(drive, GroundSource) else None
    if config.method == "dataset" and source is None:
        raise BadSetting(
            f'ground.toml: method = "dataset", but the data set of {inputs.segment} has no height map; '
            'set method = "estimate"'
        )

    def height_m(frame: Frame) -> Array:
        xyz_ego_m = points_of(frame.index).xyz_ego_m
        if source is None:
            return height_above_ground(xyz_ego_m, drive.ground_z_m, config.map)
        ground_z_m = source.ground_z(frame.index, xyz_ego_m)
        return height_above_known_ground(xyz_ego_m, ground_z_m, drive.ground_z_m, config.map)

    frames = [frame for frame in drive.frames if frame.index in inputs.window]
    for frame, heights_m in zip(frames, in_order(height_m, frames), strict=True):
        is_ground = heights_m <= config.max_height_m
        inputs.count("ground points", is_ground.sum())
        inputs.count("points above ground", (~is_ground).sum())
        if isinstance(drive, IncompleteSweeps):
            for reason, points in drive.skipped_points.get(frame.index, {}).items():
                inputs.count(reason, points)
        yield GroundRow(inputs.segment, frame.index, heights_m, is_ground)


STAGE = Stage(
    name="ground", run=run, config=GroundConfig, row=GroundRow, reads=("raw", "odometry"), windowed=True
)
