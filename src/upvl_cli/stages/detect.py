"""Boxes that the detector finds, frame by frame, joined to tracks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from upvl_cli.config.base import Config, table
from upvl_cli.detector.config import DecodeConfig, GroundingConfig
from upvl_cli.perception.tracking.config import SmoothingConfig, TrackerConfig
from upvl_cli.pipeline.stage import Needs, Stage
from upvl_cli.stages.picture_rows import PcaRow
from upvl_cli.stages.rows import GroundRow, ObjectRow, OdometryRow, TrainRow
from upvl_cli.stages.shared_columns import without_looks

if TYPE_CHECKING:
    from upvl_cli.detector.predict import FramePrediction
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Boxes, Ints


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
    from upvl_cli.perception.labels.point_features import average_pool
    from upvl_cli.runtime.spill import ArraySpill
    from upvl_cli.types import Ragged

    (fitted,) = inputs.table("pca", PcaRow)
    found: list[_FrameBoxes] = []
    # The features of points are many times all else that a frame holds: they wait on disk for the tracks.
    with ArraySpill(inputs.scratch) as features:
        for prediction in _predictions(inputs, config):
            features.append(fitted.basis.quantize(prediction.point_feature.values))
            found.append(_FrameBoxes.of_prediction(prediction))
        tracked, last = _tracked(inputs, config, found), 0
        for pose, frame, codes in zip(inputs.table("odometry", OdometryRow), found, features, strict=True):
            rows = slice(last, last := last + len(frame.boxes))
            boxes, point_feature = tracked.boxes[rows], Ragged(codes, frame.num_features)
            inputs.count("boxes", len(boxes))
            inputs.count("boxes in no track", (tracked.track_id[rows] < 0).sum())
            yield ObjectRow(
                inputs.segment,
                pose.frame,
                pose.time_ns,
                boxes.center_m,
                boxes.size_lwh_m,
                boxes.heading_rad,
                tracked.velocity_mps[rows],
                frame.num_points,
                tracked.score[rows],
                tracked.track_id[rows],
                num_features=frame.num_features,
                point_feature=point_feature,
                pooled=average_pool(point_feature, fitted.basis),
                **without_looks(len(boxes)),
            )


class _FrameBoxes(NamedTuple):
    """What is kept in memory of the boxes of one frame: some 100 bytes each."""

    boxes: Boxes
    score: Array
    num_points: Ints
    num_features: Ints

    @classmethod
    def of_prediction(cls, prediction: FramePrediction) -> _FrameBoxes:
        from upvl_cli.types import Boxes

        boxes = prediction.boxes
        return cls(
            Boxes(boxes.center_m, boxes.size_lwh_m, boxes.heading_rad),
            boxes.score,
            prediction.num_points,
            prediction.point_feature.count,
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


def _tracked(inputs: Inputs, config: DetectConfig, found: list[_FrameBoxes]) -> _Tracked:
    """Join the boxes of all frames to tracks, which give velocities and correct the boxes."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.tracking.smoothing import smooth_tracks
    from upvl_cli.perception.tracking.windows import BoxesOfFrame, track_in_windows
    from upvl_cli.types import Boxes, concat

    poses = inputs.table("odometry", OdometryRow)
    time_ns = [pose.time_ns for pose in poses]
    time_s = np.array([(time - time_ns[0]) * 1e-9 for time in time_ns])
    start = np.cumsum([0, *(len(frame.boxes) for frame in found)])
    pairs = zip(found, poses, strict=True)
    world = concat([transform(frame.boxes, pose.world_from_ego) for frame, pose in pairs], Boxes)
    velocity_mps, track_id = np.zeros((start[-1], 3)), np.full(start[-1], -1)
    still = (
        BoxesOfFrame(world[first:last], np.zeros((last - first, 3)))
        for first, last in zip(start[:-1], start[1:], strict=True)
    )
    frames = track_in_windows(still, time_s, config.tracker)
    for first, tracks, pose in zip(start[:-1], frames, poses, strict=True):
        has_box = tracks.box >= 0
        box = first + tracks.box[has_box]
        turn = np.broadcast_to(pose.world_from_ego[:3, :3], (len(box), 3, 3))
        velocity_mps[box] = np.einsum("ni,nij->nj", tracks.velocity_mps[has_box], turn)
        track_id[box] = tracks.track_id[has_box]
    score = np.concatenate([*(frame.score for frame in found), np.zeros(0)])
    if not config.smoothing.enabled:
        return _Tracked(concat([frame.boxes for frame in found], Boxes), velocity_mps, score, track_id)
    box_time_s = np.repeat(time_s, np.diff(start))
    smooth, score = smooth_tracks(world, score, track_id, box_time_s, config.smoothing)
    smooth_boxes = [
        transform(smooth[first:last], inverse(pose.world_from_ego))
        for first, last, pose in zip(start[:-1], start[1:], poses, strict=True)
    ]
    return _Tracked(concat(smooth_boxes, Boxes), velocity_mps, score, track_id)


STAGE = Stage(
    name="detect",
    run=run,
    config=DetectConfig,
    row=ObjectRow,
    reads=("raw", "odometry", "ground", "pca", "train"),
    version=2,
    needs=Needs(gpus=1.0),
)
