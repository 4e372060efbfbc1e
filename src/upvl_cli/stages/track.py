"""Which boxes of different frames are one object."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import setting
from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class TrackConfig(TrackerConfig):
    """Settings of `track`."""

    max_duplicate_share: float = setting(
        "largest share of the boxes of a track of a later hypothesis that are duplicates of those of one track of an "
        "earlier hypothesis; a track with more is dropped",
        ge=0,
        le=1,
    )


def run(inputs: Inputs, config: TrackConfig) -> Iterator[TrackRow]:
    """Associate the boxes of all frames to tracks, and fill their gaps."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse, rotate
    from upvl_cli.perception.tracking.hypotheses import Hypotheses
    from upvl_cli.perception.tracking.windows import BoxesOfFrame, track_in_windows
    from upvl_cli.types import Ints

    poses, proposals = inputs.table("odometry", OdometryRow), inputs.table("propose", ProposalRow)
    pending: deque[tuple[OdometryRow, Ints]] = deque()

    def world_boxes() -> Iterator[BoxesOfFrame]:
        """Yield the boxes of each frame and their velocities in world axes."""
        for pose in poses:
            row = proposals[pose.frame]
            pending.append((pose, row.num_points))
            yield BoxesOfFrame(
                transform(row.boxes, pose.world_from_ego),
                rotate(pose.world_from_ego, row.velocity_mps),
                Hypotheses(row.hypothesis.astype(np.int64), row.duplicate_of.astype(np.int64)),
            )

    time_ns = [pose.time_ns for pose in poses]
    time_s = np.array([(time - time_ns[0]) * 1e-9 for time in time_ns])
    for tracks in track_in_windows(world_boxes(), time_s, config, config.max_duplicate_share):
        pose, num_points = pending.popleft()
        is_seen = tracks.box >= 0
        inputs.count("boxes tracked", is_seen.sum())
        inputs.count("boxes coasted", (~is_seen).sum())
        for reason, items in tracks.dropped.items():
            inputs.count(f"tracks dropped: {reason}", items)
        ego_from_world = inverse(pose.world_from_ego)
        boxes = transform(tracks.boxes, ego_from_world)
        points_of_track = np.zeros(len(is_seen), dtype=np.int32)
        points_of_track[is_seen] = num_points[tracks.box[is_seen]]
        yield TrackRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            velocity_mps=rotate(ego_from_world, tracks.velocity_mps),
            num_points=points_of_track,
            track_id=tracks.track_id,
            proposal=tracks.box,
            hypothesis=tracks.hypothesis,
        )


STAGE = Stage(
    name="track", run=run, config=TrackConfig, row=TrackRow, reads=("odometry", "propose"), version=2
)
