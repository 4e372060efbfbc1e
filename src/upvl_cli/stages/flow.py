"""Motion of every point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class FlowParams:
    """Settings of `flow`."""

    max_speed_mps: float = param("a faster point is noise", "m/s", above=0, most=80)


@dataclass(frozen=True)
class FlowRow(Row):
    """Motion of each point of a sweep, in the order of its points."""

    flow_mps: Array = column("float16", "velocity over the ground", "m/s", "ego", per="point", shape=(3,))


def run(inputs: Inputs, params: FlowParams) -> Iterator[FlowRow]:
    """Estimate the motion of every LiDAR point relative to the ground."""
    import numpy as np

    from upvl_cli.algorithms.flow import estimate
    from upvl_cli.geometry.se3 import apply, inverse

    poses = list(inputs.table("odometry"))
    ground = inputs.table("ground")

    def above(step: int) -> tuple[Array, Array]:
        """Sweep of a step and which of its points stand above the ground."""
        frame = poses[step].frame
        return inputs.drive.points(frame).xyz_ego_m, ~ground[frame].is_ground

    xyz, keep = above(0) if poses else (np.zeros((0, 3)), np.zeros(0, bool))
    before = (xyz, keep)
    for step, pose in enumerate(poses):
        # The last sweep has no next one: its motion is the way back to the one before, turned round.
        other = step + 1 if step + 1 < len(poses) else step - 1
        flow = np.zeros((len(xyz), 3))
        after = above(other) if other == step + 1 else before
        if other >= 0:
            ego_from_other = inverse(pose.world_from_ego) @ poses[other].world_from_ego
            dt_s = (poses[other].time_ns - pose.time_ns) * 1e-9
            target = apply(ego_from_other, after[0][after[1]])
            flow[keep] = estimate(xyz[keep].astype(np.float64), target, dt_s, **vars(params))
        yield FlowRow(inputs.segment, pose.frame, flow)
        before, (xyz, keep) = (xyz, keep), after


STAGE = Stage(name="flow", run=run, params=FlowParams, row=FlowRow, reads=("raw", "odometry", "ground"))
