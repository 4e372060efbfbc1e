"""A detector that sees with LiDAR alone, learned from the auto labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.algorithms.open_vocabulary import Basis
    from upvl_cli.detector.batch import Grid
    from upvl_cli.detector.frames import DriveFrames, Source
    from upvl_cli.detector.model import Detector
    from upvl_cli.detector.together import Team
    from upvl_cli.detector.training import Plan
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class TrainParams:
    """Settings of `train`."""

    drives: tuple[str, ...] = param('names of the drives to learn from, with * for anything: "train-*"')
    held_out: float = param("share of each drive, its end, that is only looked at", least=0, most=0.9)
    grid_m: tuple[float, ...] = param(
        "ends of what is seen: x from and to, y, height above the road", "m", least=-1000, most=1000
    )
    pillar_m: float = param("side of a pillar", "m", least=0.02, most=10)
    encoder: str = param("how boxes are said", choices=("anchors", "centres"))
    width: int = param("channels of a pillar, a multiple of 8", least=8, most=1024)
    steps: int = param("steps of a round", least=1, most=10**8)
    batch: int = param("frames of a step, over all processes", least=1, most=10**5)
    rate: float = param("highest learning rate", least=1e-8, most=1)
    distil: float = param("weight of the features of points; 0 learns boxes only", least=0, most=1000)
    paste: int = param("objects of another frame that are set into each", least=0, most=1000)
    check_steps: int = param(
        "steps between looks at what is held out; from the last one a stopped run goes on",
        least=1,
        most=10**8,
    )
    rounds: int = param("trainings; each but the first learns also from what was found", least=1, most=100)
    trust: float = param("least score of what is found and learned from", least=0, most=1)
    seed: int = param("of all chance", least=0, most=2**31 - 1)
    precision: str = param(
        "half: bfloat16 where the device has units for it; full: nearly the same numbers on any",
        choices=("half", "full"),
    )


@dataclass(frozen=True)
class TrainRow(Row):
    """The detector and how it was learned; one row for all drives."""

    weights: Array = column("uint8", "the weights, as a file of safetensors", per="byte")
    grid_m: Array = column("float64", "ends of what is seen: x, y, height above the road", "m", shape=(6,))
    pillar_m: float = column("float64", "side of a pillar", "m")
    encoder: str = column("string", "how boxes are said")
    width: int = column("int64", "channels of a pillar")
    distils: bool = column("bool", "whether it says features of points")
    rate: Array = column("float64", "learning rate of each step", per="step")
    total: Array = column("float64", "loss", per="step")
    objectness: Array = column("float64", "part of the loss: where something is", per="step")
    box: Array = column("float64", "part of the loss: places and sizes", per="step")
    heading: Array = column("float64", "part of the loss: headings", per="step")
    distil: Array = column("float64", "part of the loss: features", per="step")
    check_step: Array = column("int64", "steps done at each look at what is held out", per="check")
    check_total: Array = column("float64", "loss there", per="check")

    @property
    def detector(self) -> Detector:
        """The network, ready to detect."""
        from upvl_cli.detector.checkpoint import rebuilt

        return rebuilt(
            self.weights, grid_of(self.grid_m, self.pillar_m), self.width, self.encoder, self.distils
        )


def grid_of(grid_m: Array | tuple[float, ...], pillar_m: float) -> Grid:
    """What the detector sees, from the numbers of the settings."""
    from upvl_cli.detector.batch import Grid
    from upvl_cli.errors import BadSetting

    if len(grid_m) != 6:
        raise BadSetting(f"train: grid_m has {len(grid_m)} numbers, expected 6: x from and to, y, height")
    x0, x1, y0, y1, z0, z1 = (float(end) for end in grid_m)
    return Grid((x0, x1), (y0, y1), (z0, z1), pillar_m)


def run(inputs: Inputs, params: TrainParams) -> Iterator[TrainRow]:
    """Learn a detector from the auto labels; it goes on from where a stopped run was."""
    import numpy as np
    import torch

    from upvl_cli.detector.checkpoint import LOSSES, State, keep, packed, resume
    from upvl_cli.detector.loss import Space
    from upvl_cli.detector.model import Detector
    from upvl_cli.detector.together import team
    from upvl_cli.detector.training import Lesson, learn
    from upvl_cli.parallel import threads

    (fitted,) = inputs.table("pca")
    torch.manual_seed(params.seed)
    torch.set_num_threads(threads())
    # Without a picture there is no feature to learn.
    distil = params.distil if fitted.variance_kept > 0 else 0.0
    detector = Detector(grid_of(params.grid_m, params.pillar_m), params.width, params.encoder, distil > 0)
    path, stamp = inputs.folder / "checkpoint.safetensors", inputs.stamp
    with team() as here:
        _check_batch(params, here.size)
        frames = _frames(inputs, params, detector.grid, fitted.basis, here)
        space = Space.of(fitted.mean.copy(), fitted.basis.components.copy())
        lesson = Lesson(detector, frames, space, _plan(params, distil), here)

        def kept(state: State) -> None:
            if here.rank == 0:
                keep(path, state, stamp)

        inputs.passing.append(path)
        state = learn(lesson, resume(path, stamp) or State(), keep=kept, tick=inputs.tick)
        here.wait()
    curve = np.array(state.curve).T
    checks = np.array(state.checks).reshape(-1, 2)
    yield TrainRow(
        inputs.segment,
        0,
        packed(state.best),
        np.array(params.grid_m),
        params.pillar_m,
        params.encoder,
        params.width,
        distil > 0,
        curve[0],
        **dict(zip(LOSSES, curve[1:], strict=True)),
        check_step=checks[:, 0],
        check_total=checks[:, 1],
    )


def _plan(params: TrainParams, distil: float) -> Plan:
    from upvl_cli.detector.training import Plan

    return Plan(
        steps=params.steps,
        batch=params.batch,
        rate=params.rate,
        distil=distil,
        check_steps=params.check_steps,
        rounds=params.rounds,
        trust=params.trust,
        seed=params.seed,
        half=params.precision == "half",
    )


def _frames(inputs: Inputs, params: TrainParams, grid: Grid, basis: Basis, here: Team) -> DriveFrames:
    """The frames of the drives whose names are asked for."""
    from upvl_cli.detector.frames import DriveFrames
    from upvl_cli.errors import BadSetting

    chosen = inputs.segments
    lengths = {name: len(inputs.table("odometry", name)) for name in chosen}
    if here.rank == 0:
        for name in chosen:
            inputs.sweeps(name)
    here.wait()
    frames = DriveFrames(
        lengths,
        lambda name: _source(inputs, name),
        grid=grid,
        values=basis.values,
        held_out=params.held_out,
        paste=params.paste,
        seed=params.seed,
    )
    if not frames.train:
        raise BadSetting("train: held_out leaves no frame to learn from; lower it, or add drives")
    inputs.count("frames learned from", frames.train)
    inputs.count("frames held out", frames.held_out)
    return frames


def _source(inputs: Inputs, name: str) -> Source:
    import numpy as np

    from upvl_cli.algorithms.views import SEEN
    from upvl_cli.detector.frames import Source
    from upvl_cli.detector.sweeps import Route
    from upvl_cli.types import Floats, Ints

    sweeps = inputs.sweeps(name)
    poses = list(inputs.table("odometry", name))
    features, labels = inputs.table("extract-vl", name), inputs.table("nms", name)

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


def _check_batch(params: TrainParams, processes: int) -> None:
    from upvl_cli.errors import BadSetting

    if params.batch % processes:
        raise BadSetting(f"train: batch = {params.batch} cannot be shared evenly by {processes} processes")


STAGE = Stage(
    name="train",
    run=run,
    params=TrainParams,
    row=TrainRow,
    reads=("raw", "odometry", "pca", "extract-vl", "nms"),
    whole=True,
    shared=True,
    version=2,
)
