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
    from upvl_cli.perception.flow.sweeps import OtherSweep
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class FlowConfig(Config):
    """Settings of `flow`."""

    method: Literal["rigid"] = setting(
        "how flow is estimated; rigid: one rigid motion for each connected component, by ICP"
    )
    min_interval_s: float = setting(
        "flow leads to the first sweep at least this much later: over less, slow things move less than points scatter",
        "s",
        gt=0,
        le=10,
    )
    confirm_interval_s: float = setting(
        "a third sweep, at least this far away in time, confirms the flow and shows what is slower",
        "s",
        gt=0,
        le=10,
    )
    rigid: RigidFlowConfig = table("settings of the rigid method")


@dataclass(frozen=True)
class SweepTriple:
    """A sweep and those that it is compared with, in its ego axes.

    Attributes:
        xyz_ego_m: (n, 3) points of the sweep.
        is_above: (n,) which of them stand above the ground.
        others: The sweep that the flow leads to, then one that confirms it; fewer in a short drive, see `other_steps`.
    """

    xyz_ego_m: Array
    is_above: Array
    others: tuple[OtherSweep, ...]


def run(inputs: Inputs, config: FlowConfig) -> Iterator[FlowRow]:
    """Estimate the motion of every LiDAR point relative to the ground."""
    import numpy as np

    from upvl_cli.perception.flow.rigid import estimate_rigid_flow
    from upvl_cli.runtime.parallel import in_order

    def flow_mps(triple: SweepTriple) -> Array:
        """Return the flow of a sweep; the ground, and a sweep all alone, have none."""
        flow = np.zeros((len(triple.xyz_ego_m), 3))
        if triple.others:
            source = triple.xyz_ego_m[triple.is_above].astype(np.float64)
            flow[triple.is_above] = estimate_rigid_flow(source, triple.others, config.rigid)
        return flow

    frames = inputs.table("odometry", OdometryRow).frames
    triples = _triples(inputs, config.min_interval_s, config.confirm_interval_s)
    for frame, flow in zip(frames, in_order(flow_mps, triples), strict=True):
        yield FlowRow(inputs.segment, frame, flow)


def _triples(inputs: Inputs, min_interval_s: float, confirm_interval_s: float) -> Iterator[SweepTriple]:
    """Yield each sweep with those that it is compared with; at the end of the drive they come before it."""
    from itertools import accumulate

    from upvl_cli.geometry.se3 import apply, compose, inverse
    from upvl_cli.perception.flow.sweeps import OtherSweep, other_steps
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    poses, ground = list(inputs.table("odometry", OdometryRow)), inputs.table("ground", GroundRow)
    points_of = compensated_points(inputs.drive, poses)

    def sweep(step: int) -> tuple[Array, Array]:
        frame = poses[step].frame
        return points_of(frame).xyz_ego_m, ~ground[frame].is_ground

    times_s = [(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]
    others = [other_steps(times_s, step, min_interval_s, confirm_interval_s) for step in range(len(poses))]
    first = [min([step, *compared]) for step, compared in enumerate(others)]
    needed_from = list(accumulate(reversed(first), min))[::-1]
    coming = in_order(sweep, range(len(poses)))
    sweeps: dict[int, tuple[Array, Array]] = {}
    for step, pose in enumerate(poses):
        while max(sweeps, default=-1) < max([step, *others[step]]):
            sweeps[max(sweeps, default=-1) + 1] = next(coming)
        for past in [past for past in sweeps if past < needed_from[step]]:
            del sweeps[past]
        here = inverse(pose.world_from_ego)
        seen = [
            OtherSweep(
                apply(compose(here, poses[other].world_from_ego), sweeps[other][0][sweeps[other][1]]),
                times_s[other] - times_s[step],
            )
            for other in others[step]
        ]
        yield SweepTriple(*sweeps[step], tuple(seen))


STAGE = Stage(
    name="flow", run=run, config=FlowConfig, row=FlowRow, reads=("raw", "odometry", "ground"), version=2
)
