"""Motion of every point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import FlowRow, GroundRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class FlowConfig(Config):
    """Settings of `flow`."""

    max_speed_mps: float = setting("a faster component is noise", "m/s", ge=0.1, le=80)
    eps_m: float = setting("points closer than this are one component", "m", ge=0.05, le=20)
    min_points: int = setting("points that make a neighbourhood dense", ge=1, le=10**6)
    voxel_m: float = setting("points closer than this count as one place", "m", ge=0.01, le=10)
    still_misfit: float = setting(
        "a component this close to the next sweep, in spacings, stands still", ge=0, le=100
    )
    min_gain: float = setting("motion must lower that misfit by this share", ge=0, le=1)


@dataclass(frozen=True)
class SweepPair:
    """A sweep, which of its points stand above the ground, and those of another in its ego axes."""

    xyz_ego_m: Array
    is_above: Array
    other_xyz_ego_m: Array
    dt_s: float


def run(inputs: Inputs, config: FlowConfig) -> Iterator[FlowRow]:
    """Estimate the motion of every LiDAR point relative to the ground."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.perception.flow.estimate import estimate
    from upvl_cli.runtime.parallel import in_order

    settings = asdict(config)

    def flow_mps(pair: SweepPair) -> Array:
        """The flow of a sweep; the ground, and a sweep all alone, have none."""
        flow = np.zeros((len(pair.xyz_ego_m), 3))
        if pair.dt_s:
            source = pair.xyz_ego_m[pair.is_above].astype(np.float64)
            flow[pair.is_above] = estimate(source, pair.other_xyz_ego_m, pair.dt_s, **settings)
        return flow

    frames = inputs.table("odometry", OdometryRow).frames
    for frame, flow in zip(frames, in_order(flow_mps, _pairs(inputs)), strict=True):
        yield FlowRow(inputs.segment, frame, flow)


def _pairs(inputs: Inputs) -> Iterator[SweepPair]:
    """Each sweep with the next one; the last with the one before, so that its motion is that way back, turned."""
    from upvl_cli.geometry.se3 import apply, inverse
    from upvl_cli.runtime.parallel import in_order

    poses, ground = list(inputs.table("odometry", OdometryRow)), inputs.table("ground", GroundRow)

    def sweep(step: int) -> tuple[Array, Array]:
        frame = poses[step].frame
        return inputs.drive.points(frame).xyz_ego_m, ~ground[frame].is_ground

    if not poses:
        return
    sweeps = in_order(sweep, range(len(poses)))
    before = here = next(sweeps)
    for step, pose in enumerate(poses):
        last = step + 1 == len(poses)
        other = max(step - 1, 0) if last else step + 1
        after = before if last else next(sweeps)
        (xyz_ego_m, is_above), (other_xyz_m, other_is_above) = here, after
        ego_from_other = inverse(pose.world_from_ego) @ poses[other].world_from_ego
        yield SweepPair(
            xyz_ego_m,
            is_above,
            apply(ego_from_other, other_xyz_m[other_is_above]),
            (poses[other].time_ns - pose.time_ns) * 1e-9,
        )
        before, here = here, after


STAGE = Stage(name="flow", run=run, config=FlowConfig, row=FlowRow, reads=("raw", "odometry", "ground"))
