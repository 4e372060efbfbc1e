"""What the detector finds, sweep by sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.tracking.config import SmoothingConfig, TrackerConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import GroundRow, ObjectRow, OdometryRow, PcaRow, TrainRow

if TYPE_CHECKING:
    from upvl_cli.detector.finding import Found
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class DetectConfig(Config):
    """Settings of `detect`."""

    min_score: float = setting("boxes below are dropped", ge=0, le=1)
    max_boxes: int = setting("most boxes of a frame", ge=1, le=10_000)
    nms_iou: float = setting("of two boxes that overlap more, seen from above, the worse goes", ge=0, le=1)
    tracker: TrackerConfig = table("how boxes of different frames are associated to tracks")
    smoothing: SmoothingConfig = table("how the boxes of a track correct each other")


def run(inputs: Inputs, config: DetectConfig) -> Iterator[ObjectRow]:
    """Find boxes, and the features of the points inside of them, without a picture; join the boxes to tracks.

    A point in two boxes that overlap counts for both. A box of no track has no velocity, and the number -1.
    Points are those of the box as it was found, before its track has corrected it.
    """
    import numpy as np

    from upvl_cli.perception.labels.point_features import average_pool
    from upvl_cli.types import Boxes, Ragged

    (fitted,) = inputs.table("pca", PcaRow)
    poses = list(inputs.table("odometry", OdometryRow))
    found = [*_found(inputs, config)]
    tracked = _tracked(inputs, config, found)
    last = np.cumsum([len(boxes.seven) for boxes in found])
    for pose, boxes, end in zip(poses, found, last, strict=True):
        rows = slice(end - len(boxes.seven), end)
        codes = fitted.basis.quantize(boxes.feature)
        inputs.count("boxes", len(boxes.seven))
        inputs.count("boxes in no track", (tracked.track_id[rows] < 0).sum())
        placed = Boxes.from_rows(tracked.seven[rows])
        yield ObjectRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            placed.center_m,
            placed.size_lwh_m,
            placed.heading_rad,
            tracked.velocity_mps[rows],
            boxes.points,
            tracked.score[rows],
            tracked.track_id[rows],
            num_features=np.bincount(boxes.of_box, minlength=len(boxes.seven)),
            point_feature=Ragged.grouped(boxes.of_box, codes, len(boxes.seven)),
            pooled=average_pool(Ragged.grouped(boxes.of_box, codes, len(boxes.seven)), fitted.basis),
        )


def _found(inputs: Inputs, config: DetectConfig) -> Iterator[Found]:
    """The boxes of each frame; sweeps are read ahead while the network looks."""
    import numpy as np
    import torch

    from upvl_cli.detector.finding import find
    from upvl_cli.detector.sweeps import Route
    from upvl_cli.runtime.parallel import in_order, threads

    (trained,) = inputs.table("train", TrainRow)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(threads())
    detector = trained.detector.to(device)
    poses, drive = list(inputs.table("odometry", OdometryRow)), inputs.drive
    route = Route(
        tuple(pose.frame for pose in poses),
        tuple(pose.time_ns for pose in poses),
        np.array([pose.world_from_ego for pose in poses]),
        drive.ground_z_m,
    )

    grounds = inputs.table("ground", GroundRow)

    def seen(place: int) -> tuple[Array, Array]:
        """The points of a frame and of the one before it, and the ground below those of the frame."""
        points, height_m = route.points(place, drive.points), grounds[poses[place].frame].height_m
        floor_m = points[: len(height_m), :3].astype(np.float64)  # the frame's own points come first
        floor_m[:, 2] -= height_m
        return points, floor_m

    for points, floor_m in in_order(seen, range(len(poses))):
        yield find(
            detector,
            points,
            floor_m,
            drive.ground_z_m,
            min_score=config.min_score,
            max_boxes=config.max_boxes,
            nms_iou=config.nms_iou,
        )


class _Tracked(NamedTuple):
    """The boxes of all frames, one after the other.

    Attributes:
        seven: (b, 7) in ego axes.
        velocity_mps: (b, 3) in ego axes; 0 for a box of no track.
        score: (b,) from 0 to 1.
        track_id: (b,) the number of each box's track, -1 for none.
    """

    seven: Array
    velocity_mps: Array
    score: Array
    track_id: Array


def _tracked(inputs: Inputs, config: DetectConfig, found: list[Found]) -> _Tracked:
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.tracking.smoothing import smooth_tracks
    from upvl_cli.perception.tracking.track import track
    from upvl_cli.types import Boxes, concat

    poses = list(inputs.table("odometry", OdometryRow))
    counts = [len(boxes.seven) for boxes in found]
    step = np.repeat(np.arange(len(found)), counts)
    pairs = list(zip(found, poses, strict=True))
    world = concat([transform(Boxes.from_rows(of.seven), pose.world_from_ego) for of, pose in pairs], Boxes)
    time_s = np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses])
    tracks = track(step, world, np.zeros((len(step), 3)), time_s, config.tracker)
    velocity_mps, track_id = np.zeros((len(step), 3)), np.full(len(step), -1)
    own = tracks.box >= 0
    turn = np.array([pose.world_from_ego[:3, :3] for pose in poses])
    box = tracks.box[own]
    velocity_mps[box] = np.einsum("ni,nij->nj", tracks.velocity_mps[own], turn[tracks.frame[own]])
    track_id[box] = tracks.track_id[own]
    score = np.concatenate([*(of.score for of in found), np.zeros(0)]).astype(np.float64)
    if not config.smoothing.enabled:
        seven = np.concatenate([*(of.seven for of in found), np.zeros((0, 7))])
        return _Tracked(seven, velocity_mps, score, track_id)
    better, sure = smooth_tracks(world, score, track_id, time_s[step], config.smoothing)
    ego = [transform(better[step == n], inverse(pose.world_from_ego)) for n, pose in enumerate(poses)]
    return _Tracked(concat(ego, Boxes).to_rows(), velocity_mps, sure, track_id)


STAGE = Stage(
    name="detect",
    run=run,
    config=DetectConfig,
    row=ObjectRow,
    reads=("raw", "odometry", "ground", "pca", "train"),
    version=2,
)
