"""Motion of every point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.errors import BadSetting
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.nsfp.config import NsfpFlowConfig, NsfpPlusPlusConfig
from upvl_cli.perception.flow.stored_config import StoredFlowConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import FlowRow, GroundRow, OdometryRow

if TYPE_CHECKING:
    from pathlib import Path

    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class FlowConfig(Config):
    """Settings of `flow`."""

    method: Literal["rigid", "nsfp++", "nsfp", "file"] = setting(
        "how flow is estimated; the settings of the other methods are neither used nor part of the stamp",
        effects={
            "rigid": "one rigid motion for each connected component, by ICP",
            "nsfp++": "a coordinate network for each connected component that moves, as in the paper (MI-UP, "
            "section 4.1); slower than rigid, for what deforms",
            "nsfp": "one coordinate network for the entire sweep (Li et al., NeurIPS 2021); minutes for each sweep on "
            "a CPU, for comparison",
            "file": "the flow of another program, such as a network of your own, is read from files",
        },
    )
    rigid: RigidFlowConfig = table("settings of the method rigid")
    nsfp_pp: NsfpPlusPlusConfig = table("settings of the method nsfp++")
    nsfp: NsfpFlowConfig = table("settings of the method nsfp")
    file: StoredFlowConfig = table("settings of the method file")

    def values(self) -> dict[str, Any]:
        """Return the values that the method uses: a stamp has no others."""
        used = {"nsfp++": "nsfp_pp"}.get(self.method, self.method)
        return {
            name: value for name, value in super().values().items() if name == used or name not in _TABLES
        }

    def files(self, segment: str) -> tuple[Path, ...]:
        """Return the files of a drive that the method reads."""
        return self.file.files(segment) if self.method == "file" else ()


_TABLES = ("rigid", "nsfp_pp", "nsfp", "file")


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

    from upvl_cli.runtime.parallel import in_order

    if config.method == "file":
        yield from _stored_flow(inputs, config.file)
        return
    estimate = _estimator(config)

    def flow_mps(pair: SweepPair) -> Array:
        """Return the flow of a sweep; the ground, and a sweep all alone, have none."""
        flow = np.zeros((len(pair.xyz_ego_m), 3))
        if pair.dt_s:
            source = pair.xyz_ego_m[pair.is_above].astype(np.float64)
            flow[pair.is_above] = estimate(source, pair.other_xyz_ego_m, pair.dt_s)
        return flow

    frames = inputs.table("odometry", OdometryRow).frames
    for frame, flow in zip(frames, in_order(flow_mps, _pairs(inputs)), strict=True):
        yield FlowRow(inputs.segment, frame, flow)


def _estimator(config: FlowConfig) -> Callable[[Floats, Floats, float], Floats]:
    """Return the function of a sweep, another one and the time between them that gives the flow in m/s."""
    if config.method == "nsfp++":
        from upvl_cli.perception.flow.nsfp.nsfp_plus_plus import estimate_nsfp_plus_plus_flow

        return lambda source, target, dt_s: estimate_nsfp_plus_plus_flow(source, target, dt_s, config.nsfp_pp)
    if config.method == "nsfp":
        from upvl_cli.perception.flow.nsfp.nsfp import estimate_nsfp_flow

        return lambda source, target, dt_s: estimate_nsfp_flow(source, target, dt_s, config.nsfp)
    from upvl_cli.perception.flow.rigid import estimate_rigid_flow

    return lambda source, target, dt_s: estimate_rigid_flow(source, target, dt_s, config.rigid)


def _stored_flow(inputs: Inputs, config: StoredFlowConfig) -> Iterator[FlowRow]:
    """Yield the flow that another program has written; the ground, and a sweep all alone, have none."""
    import numpy as np

    from upvl_cli.geometry.se3 import compose, inverse
    from upvl_cli.perception.flow.stored import check_speed, check_stored_flow, velocity_over_ground
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.array_files import frame_file, read_array
    from upvl_cli.runtime.parallel import in_order

    if not config.root:
        raise BadSetting('flow.toml: method = "file" needs the folder of the flow; set root in [file]')
    poses, ground = list(inputs.table("odometry", OdometryRow)), inputs.table("ground", GroundRow)
    points_of = compensated_points(inputs.drive, poses)

    def flow_mps(step: int) -> tuple[Array, bool]:
        """Return the flow of a sweep, and whether it has a file."""
        pose, other = poses[step], poses[step + 1 if step + 1 < len(poses) else max(step - 1, 0)]
        is_above = ~ground[pose.frame].is_ground
        flow = np.zeros((len(is_above), 3))
        path = frame_file(config.folder, inputs.segment, pose.frame)
        if config.missing == "zero" and not path.exists():
            return flow, False
        stored = check_stored_flow(read_array(config.folder, path), len(flow), str(path))
        if other is not pose:
            xyz_ego_m = points_of(pose.frame).xyz_ego_m.astype(np.float64)
            ego_from_other = compose(inverse(pose.world_from_ego), other.world_from_ego)
            dt_s = (other.time_ns - pose.time_ns) * 1e-9
            moving = velocity_over_ground(stored, xyz_ego_m, ego_from_other, dt_s, config)
            check_speed(moving, str(path))
            flow[is_above] = moving[is_above]
        return flow, True

    for pose, (flow, has_file) in zip(poses, in_order(flow_mps, range(len(poses))), strict=True):
        if not has_file:
            inputs.count("frames without a file of flow", 1)
        yield FlowRow(inputs.segment, pose.frame, flow)


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
