"""What the detector finds, sweep by sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

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


def run(inputs: Inputs, params: DetectParams) -> Iterator[ObjectRow]:
    """Find boxes, and the features of the points inside of them, without a picture; join the boxes to tracks.

    A point in two boxes that overlap counts for both. A box of no track has no velocity, and the number -1.
    """
    import numpy as np

    from upvl_cli.algorithms.objects import pooled

    (fitted,) = inputs.table("pca")
    poses = list(inputs.table("odometry"))
    found = [*_found(inputs, params)]
    velocity_mps, track_id = _tracked(inputs, params, found)
    last = np.cumsum([len(boxes.seven) for boxes in found])
    for pose, boxes, end in zip(poses, found, last, strict=True):
        rows = slice(end - len(boxes.seven), end)
        codes = fitted.basis.rounded(boxes.feature)
        inputs.count("boxes", len(boxes.seven))
        inputs.count("boxes in no track", (track_id[rows] < 0).sum())
        yield ObjectRow(
            inputs.segment,
            pose.frame,
            boxes.seven,
            velocity_mps[rows],
            boxes.points,
            boxes.score,
            track_id[rows],
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

    def seen(place: int) -> Array:
        return route.points(place, drive.points)

    for points in in_order(seen, range(len(poses))):
        yield find(
            detector,
            points,
            drive.ground_z_m,
            min_score=params.min_score,
            max_boxes=params.max_boxes,
            nms_iou=params.nms_iou,
        )


def _tracked(inputs: Inputs, params: DetectParams, found: list[Found]) -> tuple[Array, Array]:
    """(b, 3) velocities in ego axes and (b,) tracks of the boxes of all frames, one after the other."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.algorithms.tracking import track
    from upvl_cli.geometry.boxes import transform

    poses = list(inputs.table("odometry"))
    counts = [len(boxes.seven) for boxes in found]
    world = [transform(of.seven, pose.world_from_ego) for of, pose in zip(found, poses, strict=True)]
    values = asdict(params)
    tracks = track(
        np.repeat(np.arange(len(found)), counts),
        np.concatenate([*world, np.zeros((0, 7))]),
        np.zeros((sum(counts), 3)),
        np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]),
        **{name: values[name] for name in values if name not in ("min_score", "max_boxes", "nms_iou")},
        # What stands still is kept.
        min_reach_m=0.0,
        min_follow=-np.inf,
    )
    velocity_mps, track_id = np.zeros((sum(counts), 3)), np.full(sum(counts), -1)
    own = tracks.box >= 0
    turn = np.array([pose.world_from_ego[:3, :3] for pose in poses])
    box = tracks.box[own]
    velocity_mps[box] = np.einsum("ni,nij->nj", tracks.velocity_mps[own], turn[tracks.frame[own]])
    track_id[box] = tracks.track[own]
    return velocity_mps, track_id


STAGE = Stage(
    name="detect",
    run=run,
    params=DetectParams,
    row=ObjectRow,
    reads=("raw", "odometry", "pca", "train"),
)
