"""A detector that sees with LiDAR alone, learned from the auto labels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from upvl_cli.detector.config import TrainConfig
from upvl_cli.pipeline.stage import Needs, Stage
from upvl_cli.stages.correction_rows import corrected_boxes, corrections_table
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import AmodalRow, OdometryRow, TrainRow

if TYPE_CHECKING:
    from upvl_cli.detector.data.frames import DriveFrames, Source
    from upvl_cli.detector.grid import Grid
    from upvl_cli.perception.visual.open_vocabulary import Basis
    from upvl_cli.pipeline.stage import Inputs


def run(inputs: Inputs, config: TrainConfig) -> Iterator[TrainRow]:
    """Train a detector on the auto labels; it goes on from where a stopped run was."""
    import numpy as np
    import torch

    from upvl_cli.detector.checkpoint import (
        LOSSES,
        TrainState,
        load_checkpoint,
        pack_checkpoint,
        pack_config,
        pack_weights,
        save_checkpoint,
        unpack_checkpoint,
    )
    from upvl_cli.detector.loss import FeatureSpace
    from upvl_cli.detector.model import Detector
    from upvl_cli.detector.process_group import process_group
    from upvl_cli.detector.train import TrainSetup, train
    from upvl_cli.runtime.parallel import threads

    (fitted,) = inputs.table("pca", PcaRow)
    torch.manual_seed(config.seed)
    torch.set_num_threads(threads())
    # Without a picture there is no feature to learn.
    distills = config.distillation.enabled and fitted.variance_kept > 0
    detector = Detector(config.detector, distills)
    path = inputs.folder / "checkpoint.safetensors"
    with process_group() as group:
        _check_batch(config, group.size)
        frames = _frames(inputs, config, detector.grid, fitted.basis)
        space = FeatureSpace.from_basis(fitted.mean.copy(), fitted.basis.components.copy())
        stamp = inputs.stamp if group.rank == 0 else ""

        def save(state: TrainState) -> None:
            if group.rank == 0:
                save_checkpoint(path, state, stamp)

        inputs.discard_when_done(path)
        # The first process alone reads the checkpoint, so that all of them go on from the same step.
        begun = load_checkpoint(path, stamp) if group.rank == 0 else None
        packed = group.broadcast(pack_checkpoint(begun or TrainState(), ""))
        state = begun or unpack_checkpoint(packed, "") or TrainState()
        setup = TrainSetup(detector, frames, space, config, group)
        state = train(setup, state, save=save, tick=inputs.tick)
        group.wait()
    curve = np.array(state.curve).T
    checks = np.array(state.checks).reshape(-1, 2)
    yield TrainRow(
        inputs.segment,
        0,
        pack_weights(state.best),
        pack_config(config.detector),
        distills,
        curve[0],
        **dict(zip(LOSSES, curve[1:], strict=True)),
        check_step=checks[:, 0],
        check_total=checks[:, 1],
    )


def _frames(inputs: Inputs, config: TrainConfig, grid: Grid, basis: Basis) -> DriveFrames:
    """Return the frames of the drives whose names are asked for."""
    from upvl_cli.detector.data.frames import DriveFrames
    from upvl_cli.errors import BadSetting

    segments = inputs.segments
    corrected = {path.stem for path in config.files(inputs.segment)}.intersection(segments)
    frames = DriveFrames(
        segments,
        inputs.lengths("odometry", segments),
        lambda name: _source(inputs, config, name, is_corrected=name in corrected),
        grid=grid,
        values=basis.dequantize,
        config=config,
        corrected=corrected,
    )
    inputs.count("drives with hand corrections", len(corrected))
    if not frames.train:
        raise BadSetting("train: held_out leaves no frame to learn from; lower it, or add drives")
    inputs.count("frames learned from", frames.train)
    inputs.count("frames held out", frames.held_out)
    return frames


def _source(inputs: Inputs, config: TrainConfig, segment: str, *, is_corrected: bool) -> Source:
    """Return the frames of one drive."""
    from pathlib import Path

    import numpy as np

    from upvl_cli.detector.data.frames import Source
    from upvl_cli.detector.data.sweeps import Trajectory, TwoSweeps
    from upvl_cli.geometry.boxes import geometry_of
    from upvl_cli.perception.visual.views import SEEN
    from upvl_cli.types import Boxes, Floats, Ints

    sweeps = inputs.sweeps(segment)
    poses = list(inputs.table("odometry", OdometryRow, segment))
    features = inputs.table("extract-vl", ExtractVlRow, segment)
    labels = inputs.table("nms", AmodalRow, segment)

    def features_of(frame: int) -> tuple[Ints, Ints]:
        row = features[frame]
        return np.flatnonzero(row.state == SEEN), row.feature

    corrections = corrections_table(Path(config.hand_corrections.folder), segment) if is_corrected else None

    def labels_of(frame: int) -> tuple[Boxes, Floats]:
        boxes = labels[frame].tracked_boxes
        if corrections is not None:
            boxes = corrected_boxes(labels[frame], corrections[frame])
        return geometry_of(boxes), boxes.velocity_mps

    trajectory = Trajectory(
        np.array([pose.frame for pose in poses]),
        np.array([pose.time_ns for pose in poses]),
        np.array([pose.world_from_ego for pose in poses]),
    )
    return Source(
        TwoSweeps(trajectory, sweeps.read, sweeps.ground_z_m, config.sweeps), features_of, labels_of
    )


def _check_batch(config: TrainConfig, processes: int) -> None:
    from upvl_cli.errors import BadSetting

    if config.batch < processes:
        raise BadSetting(
            f"train: batch = {config.batch} leaves nothing to do for some of {processes} processes; raise it in "
            "stages/train.toml, or start fewer processes"
        )


STAGE = Stage(
    name="train",
    run=run,
    config=TrainConfig,
    row=TrainRow,
    reads=("raw", "odometry", "pca", "extract-vl", "nms"),
    scope="dataset",
    distributed=True,
    version=2,
    needs=Needs(cpus=8, gpus=1.0, memory_gib=16.0),  # a process a GPU; threads read the scenes ahead of it
)
