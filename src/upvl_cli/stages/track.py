"""Which boxes of different frames are one object."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


def run(inputs: Inputs, config: TrackerConfig) -> Iterator[TrackRow]:
    """Associate the boxes of all frames to tracks, and fill their gaps."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse, rotate
    from upvl_cli.perception.tracking.track import track
    from upvl_cli.types import Boxes, concat

    poses = list(inputs.table("odometry", OdometryRow))
    proposals = inputs.table("propose", ProposalRow)
    rows = [proposals[pose.frame] for pose in poses]
    counts = [len(row.num_points) for row in rows]
    step = np.repeat(np.arange(len(rows)), counts)
    row_in_frame = np.concatenate([np.zeros(0, np.int64), *(np.arange(count) for count in counts)])
    num_points = np.concatenate([np.zeros(0, np.int32), *(row.num_points for row in rows)])
    pairs = list(zip(rows, poses, strict=True))
    velocity_mps = [rotate(pose.world_from_ego, row.velocity_mps) for row, pose in pairs]
    tracks = track(
        step,
        concat([transform(row.boxes, pose.world_from_ego) for row, pose in pairs], Boxes),
        np.concatenate([np.zeros((0, 3)), *velocity_mps]),
        np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]),
        config,
    )
    inputs.count("boxes tracked", (tracks.box >= 0).sum())
    inputs.count("boxes coasted", (tracks.box < 0).sum())
    for reason, items in tracks.dropped.items():
        inputs.count(f"tracks dropped: {reason}", items)
    for number, pose in enumerate(poses):
        here = np.flatnonzero(tracks.frame == number)
        box, ego_from_world = tracks.box[here], inverse(pose.world_from_ego)
        boxes = transform(tracks.boxes[here], ego_from_world)
        yield TrackRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            velocity_mps=rotate(ego_from_world, tracks.velocity_mps[here]),
            num_points=np.where(box >= 0, num_points[box] if len(num_points) else 0, 0),
            track_id=tracks.track_id[here],
            proposal=np.where(box >= 0, row_in_frame[box] if len(num_points) else -1, -1),
        )


STAGE = Stage(name="track", run=run, config=TrackerConfig, row=TrackRow, reads=("odometry", "propose"))
