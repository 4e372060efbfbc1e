"""Boxes that the detector finds, frame by frame, joined to tracks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from upvl_cli.config.base import Config, table
from upvl_cli.detector.config import DecodeConfig, GroundingConfig
from upvl_cli.perception.tracking.config import SmoothingConfig, TrackerConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import GroundRow, ObjectRow, OdometryRow, PcaRow, TrainRow

if TYPE_CHECKING:
    from upvl_cli.detector.predict import FramePrediction
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Boxes


@dataclass(frozen=True)
class DetectConfig(Config):
    """Settings of `detect`."""

    decode: DecodeConfig = table("how boxes are read from the output of the network")
    grounding: GroundingConfig = table("how boxes are put on the ground")
    tracker: TrackerConfig = table("how boxes of different frames are associated to tracks")
    smoothing: SmoothingConfig = table("how the boxes of a track correct each other")


def run(inputs: Inputs, config: DetectConfig) -> Iterator[ObjectRow]:
    """Find boxes, and the features of the points inside of them, without a picture; join the boxes to tracks.

    A point in two boxes that overlap counts for both. A box of no track has no velocity, and the number -1.
    Points are those of the box as it was found, before its track has corrected it.
    """
    import numpy as np

    from upvl_cli.perception.labels.point_features import average_pool
    from upvl_cli.types import Ragged

    (fitted,) = inputs.table("pca", PcaRow)
    poses = list(inputs.table("odometry", OdometryRow))
    predictions = [*_predictions(inputs, config)]
    tracked = _tracked(inputs, config, predictions)
    end = np.cumsum([len(prediction.boxes) for prediction in predictions])
    for pose, prediction, last in zip(poses, predictions, end, strict=True):
        total = len(prediction.boxes)
        rows = slice(last - total, last)
        boxes, feature = tracked.boxes[rows], prediction.point_feature
        codes = fitted.basis.quantize(feature.values)
        inputs.count("boxes", total)
        inputs.count("boxes in no track", (tracked.track_id[rows] < 0).sum())
        yield ObjectRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            tracked.velocity_mps[rows],
            prediction.num_points,
            tracked.score[rows],
            tracked.track_id[rows],
            num_features=feature.count,
            point_feature=(point_feature := Ragged(codes, feature.count)),
            pooled=average_pool(point_feature, fitted.basis),
        )


def _predictions(inputs: Inputs, config: DetectConfig) -> Iterator[FramePrediction]:
    """Yield what the detector finds in each frame; sweeps are read ahead while the network computes."""
    import numpy as np
    import torch

    from upvl_cli.detector.data.sweeps import Trajectory, TwoSweeps
    from upvl_cli.detector.predict import FrameInput, predict
    from upvl_cli.runtime.parallel import in_order, threads

    (trained,) = inputs.table("train", TrainRow)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(threads())
    detector = trained.detector.to(device)
    poses, drive = list(inputs.table("odometry", OdometryRow)), inputs.drive
    trajectory = Trajectory(
        np.array([pose.frame for pose in poses]),
        np.array([pose.time_ns for pose in poses]),
        np.array([pose.world_from_ego for pose in poses]),
    )
    sweeps = TwoSweeps(trajectory, drive.points, drive.ground_z_m, detector.config.sweeps)
    grounds = inputs.table("ground", GroundRow)

    def frame_input(index: int) -> FrameInput:
        points, height_m = sweeps.points(index), grounds[poses[index].frame].height_m
        ground_xyz_m = points[: len(height_m), :3].astype(np.float64)  # the frame's own points come first
        ground_xyz_m[:, 2] -= height_m
        return FrameInput(points, ground_xyz_m, drive.ground_z_m)

    for frame in in_order(frame_input, range(len(poses))):
        yield predict(detector, frame, config.decode, config.grounding)


class _Tracked(NamedTuple):
    """The boxes of all frames, one after the other.

    Attributes:
        boxes: (b) in ego axes.
        velocity_mps: (b, 3) in ego axes; 0 for a box of no track.
        score: (b,) from 0 to 1.
        track_id: (b,) the number of each box's track, -1 for none.
    """

    boxes: Boxes
    velocity_mps: Array
    score: Array
    track_id: Array


def _tracked(inputs: Inputs, config: DetectConfig, predictions: list[FramePrediction]) -> _Tracked:
    """Join the boxes of all frames to tracks, which give velocities and correct the boxes."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.tracking.smoothing import smooth_tracks
    from upvl_cli.perception.tracking.track import track
    from upvl_cli.types import Boxes, concat

    poses = list(inputs.table("odometry", OdometryRow))
    in_ego_axes = [
        Boxes(found.boxes.center_m, found.boxes.size_lwh_m, found.boxes.heading_rad) for found in predictions
    ]
    step = np.repeat(np.arange(len(predictions)), [len(boxes) for boxes in in_ego_axes])
    pairs = zip(in_ego_axes, poses, strict=True)
    world = concat([transform(boxes, pose.world_from_ego) for boxes, pose in pairs], Boxes)
    time_s = np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses])
    tracks = track(step, world, np.zeros((len(step), 3)), time_s, config.tracker)
    velocity_mps, track_id = np.zeros((len(step), 3)), np.full(len(step), -1)
    has_box = tracks.box >= 0
    turn = np.array([pose.world_from_ego[:3, :3] for pose in poses])
    box = tracks.box[has_box]
    velocity_mps[box] = np.einsum("ni,nij->nj", tracks.velocity_mps[has_box], turn[tracks.frame[has_box]])
    track_id[box] = tracks.track_id[has_box]
    score = np.concatenate([*(found.boxes.score for found in predictions), np.zeros(0)])
    if not config.smoothing.enabled:
        return _Tracked(concat(in_ego_axes, Boxes), velocity_mps, score, track_id)
    smooth, score = smooth_tracks(world, score, track_id, time_s[step], config.smoothing)
    smooth_boxes = [
        transform(smooth[step == n], inverse(pose.world_from_ego)) for n, pose in enumerate(poses)
    ]
    return _Tracked(concat(smooth_boxes, Boxes), velocity_mps, score, track_id)


STAGE = Stage(
    name="detect",
    run=run,
    config=DetectConfig,
    row=ObjectRow,
    reads=("raw", "odometry", "ground", "pca", "train"),
    version=2,
)
