"""Which boxes of different frames are one object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class TrackConfig(Config):
    """Settings of `track`."""

    agility_m2ps3: float = setting(
        "how strongly objects accelerate, as a spectral density", "m^2/s^3", ge=0.001, le=10_000
    )
    position_noise_m: float = setting("standard deviation of a box's centre", "m", ge=0.001, le=100)
    velocity_noise_mps: float = setting("standard deviation of a box's velocity", "m/s", ge=0.001, le=200)
    gate: float = setting("standard deviations within which a box can be the track's", ge=0.1, le=100)
    max_coast_s: float = setting("a track ends when it has had no box for longer", "s", ge=0, le=3600)
    max_gap_s: float = setting("tracks this far apart in time can be one object", "s", ge=0, le=3600)
    min_boxes: int = setting("drop a track with fewer boxes", ge=1, le=10**6)
    min_reach_m: float = setting("drop a track whose motion never takes it further", "m", ge=0, le=10_000)
    min_follow: float = setting(
        "drop a track that moves on by a smaller share of what its flow claims", ge=-1000, le=1
    )


def run(inputs: Inputs, config: TrackConfig) -> Iterator[TrackRow]:
    """Join the boxes of all frames to tracks, and fill their gaps."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.tracking.track import track
    from upvl_cli.types import Boxes

    poses = list(inputs.table("odometry", OdometryRow))
    proposals = inputs.table("propose", ProposalRow)
    rows = [proposals[pose.frame] for pose in poses]
    step = np.repeat(np.arange(len(rows)), [len(row.num_points) for row in rows])
    number_in_frame = np.concatenate(
        [np.arange(len(row.num_points)) for row in rows] or [np.zeros(0, np.int64)]
    )
    points = np.concatenate([row.num_points for row in rows] or [np.zeros(0, np.int32)])
    world = [
        transform(row.boxes.to_rows(), pose.world_from_ego) for row, pose in zip(rows, poses, strict=True)
    ]
    turned = [row.velocity_mps @ pose.world_from_ego[:3, :3].T for row, pose in zip(rows, poses, strict=True)]
    tracks = track(
        step,
        np.concatenate([*world, np.zeros((0, 7))]),
        np.concatenate([*turned, np.zeros((0, 3))]),
        np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]),
        **asdict(config),
    )
    inputs.count("boxes tracked", (tracks.box >= 0).sum())
    inputs.count("boxes coasted", (tracks.box < 0).sum())
    for reason, items in tracks.dropped.items():
        inputs.count(f"tracks dropped: {reason}", items)
    for number, pose in enumerate(poses):
        here = np.flatnonzero(tracks.frame == number)
        box = tracks.box[here]
        boxes = transform(Boxes.from_rows(tracks.seven[here]), inverse(pose.world_from_ego))
        yield TrackRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            velocity_mps=tracks.velocity_mps[here] @ pose.world_from_ego[:3, :3],
            num_points=np.where(box >= 0, points[box] if len(points) else 0, 0),
            track_id=tracks.track[here],
            proposal=np.where(box >= 0, number_in_frame[box] if len(points) else -1, -1),
        )


STAGE = Stage(name="track", run=run, config=TrackConfig, row=TrackRow, reads=("odometry", "propose"))
