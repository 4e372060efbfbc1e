"""A detector that sees with LiDAR alone, learned from the auto labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, ExtractVlRow, OdometryRow, PcaRow, TrainRow

if TYPE_CHECKING:
    from upvl_cli.detector.batch import Grid
    from upvl_cli.detector.frames import DriveFrames, Source
    from upvl_cli.detector.together import Team
    from upvl_cli.detector.training import Plan
    from upvl_cli.perception.visual.open_vocabulary import Basis
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class TrainConfig(Config):
    """Settings of `train`."""

    drives: tuple[str, ...] = setting('names of the drives to learn from, with * for anything: "train-*"')
    held_out: float = setting("share of each drive, its end, that is only looked at", ge=0, le=0.9)
    grid_m: tuple[float, ...] = setting(
        "ends of what is seen: x from and to, y, height above the road", "m", ge=-1000, le=1000
    )
    pillar_m: float = setting("side of a pillar", "m", ge=0.02, le=10)
    encoder: Literal["anchors", "centres"] = setting("how boxes are said")
    width: int = setting("channels of a pillar, a multiple of 8", ge=8, le=1024)
    steps: int = setting("steps of a round", ge=1, le=10**8)
    batch: int = setting("frames of a step, over all processes", ge=1, le=10**5)
    rate: float = setting("highest learning rate", ge=1e-8, le=1)
    distil: float = setting("weight of the features of points; 0 learns boxes only", ge=0, le=1000)
    paste: int = setting("objects of another frame that are set into each", ge=0, le=1000)
    check_steps: int = setting(
        "steps between looks at what is held out; from the last one a stopped run goes on",
        ge=1,
        le=10**8,
    )
    rounds: int = setting("trainings; each but the first learns also from what was found", ge=1, le=100)
    trust: float = setting("least score of what is found and learned from", ge=0, le=1)
    seed: int = setting("of all chance", ge=0, le=2**31 - 1)
    precision: Literal["half", "full"] = setting(
        "half: bfloat16 where the device has units for it; full: nearly the same numbers on any"
    )


def run(inputs: Inputs, config: TrainConfig) -> Iterator[TrainRow]:
    """Learn a detector from the auto labels; it goes on from where a stopped run was."""
    import numpy as np
    import torch

    from upvl_cli.detector.batch import grid_of
    from upvl_cli.detector.checkpoint import LOSSES, State, keep, packed, resume
    from upvl_cli.detector.loss import Space
    from upvl_cli.detector.model import Detector
    from upvl_cli.detector.together import team
    from upvl_cli.detector.training import Lesson, learn
    from upvl_cli.runtime.parallel import threads

    (fitted,) = inputs.table("pca", PcaRow)
    torch.manual_seed(config.seed)
    torch.set_num_threads(threads())
    # Without a picture there is no feature to learn.
    distil = config.distil if fitted.variance_kept > 0 else 0.0
    detector = Detector(grid_of(config.grid_m, config.pillar_m), config.width, config.encoder, distil > 0)
    path, stamp = inputs.folder / "checkpoint.safetensors", inputs.stamp
    with team() as here:
        _check_batch(config, here.size)
        frames = _frames(inputs, config, detector.grid, fitted.basis, here)
        space = Space.of(fitted.mean.copy(), fitted.basis.components.copy())
        lesson = Lesson(detector, frames, space, _plan(config, distil), here)

        def kept(state: State) -> None:
            if here.rank == 0:
                keep(path, state, stamp)

        inputs.discard_when_done(path)
        state = learn(lesson, resume(path, stamp) or State(), keep=kept, tick=inputs.tick)
        here.wait()
    curve = np.array(state.curve).T
    checks = np.array(state.checks).reshape(-1, 2)
    yield TrainRow(
        inputs.segment,
        0,
        packed(state.best),
        np.array(config.grid_m),
        config.pillar_m,
        config.encoder,
        config.width,
        distil > 0,
        curve[0],
        **dict(zip(LOSSES, curve[1:], strict=True)),
        check_step=checks[:, 0],
        check_total=checks[:, 1],
    )


def _plan(config: TrainConfig, distil: float) -> Plan:
    from upvl_cli.detector.training import Plan

    return Plan(
        steps=config.steps,
        batch=config.batch,
        rate=config.rate,
        distil=distil,
        check_steps=config.check_steps,
        rounds=config.rounds,
        trust=config.trust,
        seed=config.seed,
        half=config.precision == "half",
    )


def _frames(inputs: Inputs, config: TrainConfig, grid: Grid, basis: Basis, here: Team) -> DriveFrames:
    """The frames of the drives whose names are asked for."""
    from upvl_cli.detector.frames import DriveFrames
    from upvl_cli.errors import BadSetting

    chosen = inputs.segments
    lengths = {name: len(inputs.table("odometry", OdometryRow, name)) for name in chosen}
    if here.rank == 0:
        for name in chosen:
            inputs.sweeps(name)
    here.wait()
    frames = DriveFrames(
        lengths,
        lambda name: _source(inputs, name),
        grid=grid,
        values=basis.dequantize,
        held_out=config.held_out,
        paste=config.paste,
        seed=config.seed,
    )
    if not frames.train:
        raise BadSetting("train: held_out leaves no frame to learn from; lower it, or add drives")
    inputs.count("frames learned from", frames.train)
    inputs.count("frames held out", frames.held_out)
    return frames


def _source(inputs: Inputs, name: str) -> Source:
    import numpy as np

    from upvl_cli.detector.frames import Source
    from upvl_cli.detector.sweeps import Route
    from upvl_cli.perception.visual.views import SEEN
    from upvl_cli.types import Floats, Ints

    sweeps = inputs.sweeps(name)
    poses = list(inputs.table("odometry", OdometryRow, name))
    features, labels = inputs.table("extract-vl", ExtractVlRow, name), inputs.table("nms", AmodalRow, name)

    def seen(frame: int) -> tuple[Ints, Ints]:
        row = features[frame]
        return np.flatnonzero(row.state == SEEN), row.feature

    def labelled(frame: int) -> tuple[Floats, Floats]:
        row = labels[frame]
        return row.seven, row.velocity_mps

    route = Route(
        tuple(pose.frame for pose in poses),
        tuple(pose.time_ns for pose in poses),
        np.array([pose.world_from_ego for pose in poses]),
        sweeps.ground_z_m,
    )
    return Source(route, sweeps.read, seen, labelled)


def _check_batch(config: TrainConfig, processes: int) -> None:
    from upvl_cli.errors import BadSetting

    if config.batch % processes:
        raise BadSetting(f"train: batch = {config.batch} cannot be shared evenly by {processes} processes")


STAGE = Stage(
    name="train",
    run=run,
    config=TrainConfig,
    row=TrainRow,
    reads=("raw", "odometry", "pca", "extract-vl", "nms"),
    scope="dataset",
    distributed=True,
    version=2,
)
