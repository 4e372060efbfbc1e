"""What the detector finds, sweep by sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from upvl_cli.rows import ObjectRow
from upvl_cli.stage import Stage, param

if TYPE_CHECKING:
    from upvl_cli.detector.finding import Found
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class DetectParams:
    """Settings of `detect`."""

    min_score: float = param("boxes below are dropped", least=0, most=1)
    max_boxes: int = param("most boxes of a frame", least=1, most=10_000)
    nms_iou: float = param("of two boxes that overlap more, seen from above, the worse goes", least=0, most=1)
    agility_m2ps3: float = param(
        "how strongly objects accelerate, as a spectral density", "m^2/s^3", least=0.001, most=10_000
    )
    position_noise_m: float = param("standard deviation of a box's centre", "m", least=0.001, most=100)
    velocity_noise_mps: float = param(
        "standard deviation of velocities: boxes come without, and start from 0", "m/s", least=0.001, most=200
    )
    gate: float = param("standard deviations within which a box can be the track's", least=0.1, most=100)
    max_coast_s: float = param("a track ends when it has had no box for longer", "s", least=0, most=3600)
    max_gap_s: float = param("tracks this far apart in time can be one object", "s", least=0, most=3600)
    min_boxes: int = param("a track with fewer boxes is none", least=1, most=10**6)
    refine: bool = param(
        "correct each box by those of its track before and after: size, place, heading, score"
    )


def run(inputs: Inputs, params: DetectParams) -> Iterator[ObjectRow]:
    """Find boxes, and the features of the points inside of them, without a picture; join the boxes to tracks.

    A point in two boxes that overlap counts for both. A box of no track has no velocity, and the number -1.
    Points are those of the box as it was found, before its track has corrected it.
    """
    import numpy as np

    from upvl_cli.algorithms.objects import pooled

    (fitted,) = inputs.table("pca")
    poses = list(inputs.table("odometry"))
    found = [*_found(inputs, params)]
    tracked = _tracked(inputs, params, found)
    last = np.cumsum([len(boxes.seven) for boxes in found])
    for pose, boxes, end in zip(poses, found, last, strict=True):
        rows = slice(end - len(boxes.seven), end)
        codes = fitted.basis.rounded(boxes.feature)
        inputs.count("boxes", len(boxes.seven))
        inputs.count("boxes in no track", (tracked.track_id[rows] < 0).sum())
        yield ObjectRow(
            inputs.segment,
            pose.frame,
            tracked.seven[rows],
            tracked.velocity_mps[rows],
            boxes.points,
            tracked.score[rows],
            tracked.track_id[rows],
            time_ns=pose.time_ns,
            of_box=boxes.of_box,
            feature=codes,
            pooled=pooled(boxes.of_box, codes, len(boxes.seven), fitted.basis),
        )


def _found(inputs: Inputs, params: DetectParams) -> Iterator[Found]:
    """The boxes of each frame; sweeps are read ahead while the network looks."""
    import numpy as np
    import torch

    from upvl_cli.detector.finding import find
    from upvl_cli.detector.sweeps import Route
    from upvl_cli.parallel import in_order, threads

    (trained,) = inputs.table("train")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(threads())
    detector = trained.detector.to(device)
    poses, drive = list(inputs.table("odometry")), inputs.drive
    route = Route(
        tuple(pose.frame for pose in poses),
        tuple(pose.time_ns for pose in poses),
        np.array([pose.world_from_ego for pose in poses]),
        drive.ground_z_m,
    )

    grounds = inputs.table("ground")

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
            min_score=params.min_score,
            max_boxes=params.max_boxes,
            nms_iou=params.nms_iou,
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


def _tracked(inputs: Inputs, params: DetectParams, found: list[Found]) -> _Tracked:
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.algorithms.refinement import refined
    from upvl_cli.algorithms.tracking import track
    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse

    poses = list(inputs.table("odometry"))
    counts = [len(boxes.seven) for boxes in found]
    step = np.repeat(np.arange(len(found)), counts)
    pairs = list(zip(found, poses, strict=True))
    world = np.concatenate(
        [*(transform(of.seven, pose.world_from_ego) for of, pose in pairs), np.zeros((0, 7))]
    )
    time_s = np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses])
    values = asdict(params)
    tracks = track(
        step,
        world,
        np.zeros((len(step), 3)),
        time_s,
        **{
            name: values[name]
            for name in values
            if name not in ("min_score", "max_boxes", "nms_iou", "refine")
        },
        # What stands still is kept.
        min_reach_m=0.0,
        min_follow=-np.inf,
    )
    velocity_mps, track_id = np.zeros((len(step), 3)), np.full(len(step), -1)
    own = tracks.box >= 0
    turn = np.array([pose.world_from_ego[:3, :3] for pose in poses])
    box = tracks.box[own]
    velocity_mps[box] = np.einsum("ni,nij->nj", tracks.velocity_mps[own], turn[tracks.frame[own]])
    track_id[box] = tracks.track[own]
    score = np.concatenate([*(of.score for of in found), np.zeros(0)]).astype(np.float64)
    if not params.refine:
        seven = np.concatenate([*(of.seven for of in found), np.zeros((0, 7))])
        return _Tracked(seven, velocity_mps, score, track_id)
    better, sure = refined(world, score, track_id, time_s[step])
    ego = [transform(better[step == n], inverse(pose.world_from_ego)) for n, pose in enumerate(poses)]
    return _Tracked(np.concatenate([*ego, np.zeros((0, 7))]), velocity_mps, sure, track_id)


STAGE = Stage(
    name="detect",
    run=run,
    params=DetectParams,
    row=ObjectRow,
    reads=("raw", "odometry", "ground", "pca", "train"),
    version=2,
)
