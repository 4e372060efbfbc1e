"""Motion of every point."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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

    from upvl_cli.perception.flow.sweeps import OtherSweep
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

    from upvl_cli.runtime.parallel import in_order

    if config.method == "file":
        yield from _stored_flow(inputs, config.file)
        return
    estimate = _estimator(config)

    def flow_mps(triple: SweepTriple) -> Array:
        """Return the flow of a sweep; the ground, and a sweep all alone, have none."""
        flow = np.zeros((len(triple.xyz_ego_m), 3))
        if triple.others:
            source = triple.xyz_ego_m[triple.is_above].astype(np.float64)
            flow[triple.is_above] = estimate(source, triple.others)
        return flow

    frames = [frame for frame in inputs.table("odometry", OdometryRow).frames if frame in inputs.window]
    triples = _triples(inputs, config.min_interval_s, config.confirm_interval_s)
    for frame, flow in zip(frames, in_order(flow_mps, triples), strict=True):
        yield FlowRow(inputs.segment, frame, flow)


def _estimator(config: FlowConfig) -> Callable[[Floats, Sequence[OtherSweep]], Floats]:
    """Return the function of a sweep and those that it is compared with that gives the flow in m/s."""
    if config.method == "nsfp++":
        from upvl_cli.perception.flow.nsfp.nsfp_plus_plus import estimate_nsfp_plus_plus_flow

        return lambda source, others: estimate_nsfp_plus_plus_flow(
            source, others[0].xyz_m, others[0].dt_s, config.nsfp_pp
        )
    if config.method == "nsfp":
        from upvl_cli.perception.flow.nsfp.nsfp import estimate_nsfp_flow

        return lambda source, others: estimate_nsfp_flow(source, others[0].xyz_m, others[0].dt_s, config.nsfp)
    from upvl_cli.perception.flow.rigid import estimate_rigid_flow

    return lambda source, others: estimate_rigid_flow(source, others, config.rigid)


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

    steps = [step for step, pose in enumerate(poses) if pose.frame in inputs.window]
    for step, (flow, has_file) in zip(steps, in_order(flow_mps, steps), strict=True):
        if not has_file:
            inputs.count("frames without a file of flow", 1)
        yield FlowRow(inputs.segment, poses[step].frame, flow)


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
    steps = [step for step, pose in enumerate(poses) if pose.frame in inputs.window]
    held_to = needed_from[steps[0]] if steps else 0  # the step after the last whose sweep was read
    coming = in_order(sweep, range(held_to, len(poses)))
    sweeps: dict[int, tuple[Array, Array]] = {}
    for step in steps:
        pose = poses[step]
        while held_to <= max([step, *others[step]]):
            sweeps[held_to], held_to = next(coming), held_to + 1
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
    name="flow",
    run=run,
    config=FlowConfig,
    row=FlowRow,
    reads=("raw", "odometry", "ground"),
    windowed=True,
    version=2,
)
