"""What labels of a drive lack and its points and poses give: velocities, and how many points are inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array, Boxes, Drive, Frame, Labels


def velocities_of_tracks(labels: Labels, frames: Sequence[Frame], world_from_ego: Array | None) -> Array:
    """Return (n, 3) velocities over the ground along the ego axes, from the neighboring labels of each object.

    They are NaN for an object with one label, and without poses.

    Args:
        labels: The labels of a drive, all of them in its frames.
        frames: The frames of the drive.
        world_from_ego: (T, 4, 4) pose of each frame, or None.
    """
    velocity = np.full((len(labels), 3), np.nan)
    if world_from_ego is None or not len(labels):
        return velocity
    step = np.searchsorted([frame.index for frame in frames], labels.frame)
    time_ns = np.array([frame.time_ns for frame in frames])[step]
    poses = world_from_ego[step]  # (n, 4, 4)
    center_world_m = apply(poses, labels.center_m[:, None])[:, 0]
    order = np.lexsort((labels.frame, labels.object_id))
    same = labels.object_id[order][1:] == labels.object_id[order][:-1]
    before, after = order.copy(), order.copy()
    before[1:][same], after[:-1][same] = order[:-1][same], order[1:][same]
    seconds = (time_ns[after] - time_ns[before]) / 1e9
    moved = seconds > 0
    velocity[order[moved]] = (center_world_m[after] - center_world_m[before])[moved] / seconds[moved, None]
    return (velocity[:, None] @ poses[:, :3, :3])[:, 0]


def count_points(labels: Labels, drive: Drive) -> Labels:
    """Return the labels with the number of LiDAR points inside of each."""
    count = np.zeros(len(labels), dtype=np.int64)
    for frame in np.unique(labels.frame).tolist():
        here = labels.frame == frame
        boxes = Boxes(labels.center_m[here], labels.size_lwh_m[here], labels.heading_rad[here])
        count[here] = points_inside(drive.points(frame).xyz_ego_m, boxes, margin_m=0.0).sum(axis=1)
    return replace(labels, num_points=count)
