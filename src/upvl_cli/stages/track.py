"""Which boxes of different frames are one object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.rows import BoxRow
from upvl_cli.stage import Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class TrackParams:
    """Settings of `track`."""

    agility_m2ps3: float = param(
        "how strongly objects accelerate, as a spectral density", "m^2/s^3", least=0.001, most=10_000
    )
    position_noise_m: float = param("standard deviation of a box's centre", "m", least=0.001, most=100)
    velocity_noise_mps: float = param("standard deviation of a box's velocity", "m/s", least=0.001, most=200)
    gate: float = param("standard deviations within which a box can be the track's", least=0.1, most=100)
    max_coast_s: float = param("a track ends when it has had no box for longer", "s", least=0, most=3600)
    max_gap_s: float = param("tracks this far apart in time can be one object", "s", least=0, most=3600)
    min_boxes: int = param("drop a track with fewer boxes", least=1, most=10**6)
    min_reach_m: float = param("drop a track whose motion never takes it further", "m", least=0, most=10_000)
    min_follow: float = param(
        "drop a track that moves on by a smaller share of what its flow claims", least=-1000, most=1
    )


@dataclass(frozen=True)
class TrackRow(BoxRow):
    """Tracked boxes of one frame."""

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    proposal: Array = column(
        "int32", "row of the box among the proposals of its frame, -1 where coasting", per="box"
    )


def run(inputs: Inputs, params: TrackParams) -> Iterator[TrackRow]:
    """Join the boxes of all frames to tracks, and fill their gaps."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.algorithms.tracking import track
    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse

    poses = list(inputs.table("odometry"))
    rows = [inputs.table("propose")[pose.frame] for pose in poses]
    step = np.repeat(np.arange(len(rows)), [len(row.seven) for row in rows])
    number_in_frame = np.concatenate([np.arange(len(row.seven)) for row in rows] or [np.zeros(0, np.int64)])
    points = np.concatenate([row.points for row in rows] or [np.zeros(0, np.int32)])
    world = [transform(row.seven, pose.world_from_ego) for row, pose in zip(rows, poses, strict=True)]
    turned = [row.velocity_mps @ pose.world_from_ego[:3, :3].T for row, pose in zip(rows, poses, strict=True)]
    tracks = track(
        step,
        np.concatenate([*world, np.zeros((0, 7))]),
        np.concatenate([*turned, np.zeros((0, 3))]),
        np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]),
        **asdict(params),
    )
    inputs.count("boxes tracked", (tracks.box >= 0).sum())
    inputs.count("boxes coasted", (tracks.box < 0).sum())
    for reason, items in tracks.dropped.items():
        inputs.count(f"tracks dropped: {reason}", items)
    for number, pose in enumerate(poses):
        here = np.flatnonzero(tracks.frame == number)
        box = tracks.box[here]
        yield TrackRow(
            inputs.segment,
            pose.frame,
            seven=transform(tracks.seven[here], inverse(pose.world_from_ego)),
            velocity_mps=tracks.velocity_mps[here] @ pose.world_from_ego[:3, :3],
            points=np.where(box >= 0, points[box] if len(points) else 0, 0),
            track_id=tracks.track[here],
            proposal=np.where(box >= 0, number_in_frame[box] if len(points) else -1, -1),
        )


STAGE = Stage(name="track", run=run, params=TrackParams, row=TrackRow, reads=("odometry", "propose"))
