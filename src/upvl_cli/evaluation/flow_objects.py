"""Flow of labelled objects: the mean flow of the points in each box against the velocity of the label."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import fresh_table, labelled_frames, with_velocities
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.metrics.flow_objects import ObjectFlows, ObjectFlowScore, object_flow_score
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import FlowRow, GroundRow, OdometryRow
from upvl_cli.types import Labels, concat, empty


def labelled_flow_score(
    workspace: Workspace, settings: EvalConfig, segments: Collection[str] = ()
) -> ObjectFlowScore:
    """Return the score of the flow of labelled objects in all drives; ground points in their boxes do not count.

    Args:
        workspace: The workspace whose flow is scored.
        settings: Speed from which an object moves, and the groups.
        segments: Names of the drives; empty takes all.

    Raises:
        BadInput: No drive has labels.
        NotMade: A drive has no flow, or it was made with other settings.
    """
    source, frames, _ = labelled_frames(workspace, segments)
    flows = [empty(ObjectFlows)]
    for segment, labelled in frames.items():
        labels = with_velocities(workspace, segment, source.labels(segment))
        labels = labels[np.isin(labels.frame, labelled) & np.isfinite(labels.velocity_mps).all(axis=1)]
        flows += _object_flows(workspace, segment, labels, settings.moving_mps)
    return object_flow_score(
        concat(flows, ObjectFlows),
        moving_mps=settings.moving_mps,
        range_edges_m=settings.range_edges_m,
        speed_edges_mps=settings.speed_edges_mps,
    )


def _object_flows(
    workspace: Workspace, segment: str, labels: Labels, moving_mps: float
) -> Iterator[ObjectFlows]:
    """Yield the objects of each labelled frame that hold points above the ground."""
    flow, ground = (
        fresh_table(workspace, "flow", FlowRow, segment),
        fresh_table(workspace, "ground", GroundRow, segment),
    )
    poses = list(fresh_table(workspace, "odometry", OdometryRow, segment))
    times_ns = np.array([pose.time_ns for pose in poses])
    drive = workspace.drive(segment)
    for step, pose in enumerate(poses):
        boxes = labels[labels.frame == pose.frame]
        if not len(boxes) or len(poses) < 2:
            continue
        above = ~ground[pose.frame].is_ground
        flow_mps = flow[pose.frame].flow_mps[above].astype(np.float64)
        box, point = pairs_inside(drive.points(pose.frame).xyz_ego_m[above], boxes, margin_m=0.0)
        count = np.bincount(box, minlength=len(boxes))
        sums = [np.bincount(box, flow_mps[point, axis], len(boxes)) for axis in range(3)]
        is_moving = np.linalg.norm(flow_mps[point], axis=1) > moving_mps
        other = step + 1 if step + 1 < len(poses) else step - 1
        seen = count > 0
        yield ObjectFlows(
            predicted_mps=(np.stack(sums, axis=1) / np.maximum(count, 1)[:, None])[seen],
            true_mps=boxes.velocity_mps[seen],
            range_m=np.linalg.norm(boxes.center_m[seen, :2], axis=1),
            points=count[seen],
            moving_points=np.bincount(box[is_moving], minlength=len(boxes))[seen],
            interval_s=np.full(int(seen.sum()), abs(times_ns[other] - times_ns[step]) * 1e-9),
        )
