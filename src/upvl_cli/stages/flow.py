"""Motion of every point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import FlowRow, GroundRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class FlowConfig(Config):
    """Settings of `flow`."""

    method: Literal["rigid"] = setting(
        "how flow is estimated; rigid: one rigid motion for each connected component, by ICP"
    )
    rigid: RigidFlowConfig = table("settings of the rigid method")


@dataclass(frozen=True)
class SweepPair:
    """A sweep and the points above the ground of another one, in the ego axes of the first.

    Attributes:
        xyz_ego_m: (n, 3) points of the sweep.
        is_above: (n,) which of them stand above the ground.
        other_xyz_ego_m: (m, 3) points of the other sweep that stand above the ground.
        dt_s: Time from the sweep to the other one; 0 where there is no other.
    """

    xyz_ego_m: Array
    is_above: Array
    other_xyz_ego_m: Array
    dt_s: float


def run(inputs: Inputs, config: FlowConfig) -> Iterator[FlowRow]:
    """Estimate the motion of every LiDAR point relative to the ground."""
    import numpy as np

    from upvl_cli.perception.flow.rigid import estimate_rigid_flow
    from upvl_cli.runtime.parallel import in_order

    def flow_mps(pair: SweepPair) -> Array:
        """Return the flow of a sweep; the ground, and a sweep all alone, have none."""
        flow = np.zeros((len(pair.xyz_ego_m), 3))
        if pair.dt_s:
            source = pair.xyz_ego_m[pair.is_above].astype(np.float64)
            flow[pair.is_above] = estimate_rigid_flow(source, pair.other_xyz_ego_m, pair.dt_s, config.rigid)
        return flow

    frames = inputs.table("odometry", OdometryRow).frames
    for frame, flow in zip(frames, in_order(flow_mps, _pairs(inputs)), strict=True):
        yield FlowRow(inputs.segment, frame, flow)


def _pairs(inputs: Inputs) -> Iterator[SweepPair]:
    """Pair each sweep with the next one, and the last with the one before: backward in time, dt is negative."""
    from upvl_cli.geometry.se3 import apply, compose, inverse
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    poses, ground = list(inputs.table("odometry", OdometryRow)), inputs.table("ground", GroundRow)

    points_of = compensated_points(inputs.drive, poses)

    def sweep(step: int) -> tuple[Array, Array]:
        frame = poses[step].frame
        return points_of(frame).xyz_ego_m, ~ground[frame].is_ground

    if not poses:
        return
    sweeps = in_order(sweep, range(len(poses)))
    before = here = next(sweeps)
    for step, pose in enumerate(poses):
        is_last = step + 1 == len(poses)
        paired = max(step - 1, 0) if is_last else step + 1
        after = before if is_last else next(sweeps)
        (xyz_ego_m, is_above), (other_xyz_m, other_is_above) = here, after
        ego_from_other = compose(inverse(pose.world_from_ego), poses[paired].world_from_ego)
        yield SweepPair(
            xyz_ego_m,
            is_above,
            apply(ego_from_other, other_xyz_m[other_is_above]),
            (poses[paired].time_ns - pose.time_ns) * 1e-9,
        )
        before, here = here, after


STAGE = Stage(name="flow", run=run, config=FlowConfig, row=FlowRow, reads=("raw", "odometry", "ground"))
