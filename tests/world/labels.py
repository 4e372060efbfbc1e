"""Exact labels of the made-up drives, for evaluation only."""

from __future__ import annotations

import numpy as np

from upvl_cli.datasets.exact_labels import FrameBoxes, exact_labels
from upvl_cli.geometry.boxes import pairs_inside, transform
from upvl_cli.geometry.se3 import inverse, yaw_of
from upvl_cli.types import Array, Bools, Boxes, Ints, Labels
from world.street import RATE_HZ, StreetDrive, Streets

# Waymo's numbers.
TYPES = {"Car": 1, "Truck": 1, "Bus": 1, "Pedestrian": 2, "Cyclist": 4}


class StreetLabels:
    """Labels of the segments that `Streets` makes from the same settings (a `LabelSource`)."""

    def __init__(self, *, frames: int = 20, seeds: tuple[int, ...] = (0,)) -> None:
        """Offer the labels of these streets."""
        self._dataset = Streets(frames=frames, seeds=seeds)

    def labels(self, segment: str) -> Labels:
        """Return the boxes of all road users that the LiDAR ever sees, in all frames.

        Raises:
            BadInput: There is no such segment.
        """
        drive = self._dataset.open(segment)
        things = np.array([number for number, thing in enumerate(drive.scene.things) if thing.kind])
        frames = [_boxes(drive, frame.index, things) for frame in drive.frames]
        kinds = [drive.scene.things[thing].kind for thing in things]
        return exact_labels(drive.frames, frames, things, kinds, [TYPES[kind] for kind in kinds])

    def frames(self, segment: str) -> Ints:
        """Return all frames: each is labelled."""
        return np.array([frame.index for frame in self._dataset.open(segment).frames])

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return (n,) true: every place is labelled.

        Args:
            segment: Name of the segment.
            xyz_ego_m: (n, 3) places.
        """
        return np.ones(len(xyz_ego_m), dtype=np.bool_)


def _boxes(drive: StreetDrive, frame: int, things: Ints) -> FrameBoxes:
    """Return the boxes of things in one frame, their velocities, points inside, and which gave points."""
    points, truth = drive.points_with_truth(frame)
    chosen = [drive.scene.things[thing] for thing in things]
    now, later = (
        np.array([drive.scene.world_from(thing.motion, (frame + step) / RATE_HZ) for thing in chosen])
        for step in (0, 1)
    )
    size_m = np.array([thing.size_lwh_m for thing in chosen])
    middle_m = now[:, :3, 3] + size_m * [0.0, 0.0, 0.5]
    pose = drive.world_from_ego[frame]
    boxes = transform(Boxes(middle_m, size_m, yaw_of(now)), inverse(pose))
    velocity_mps = (later - now)[:, :3, 3] @ pose[:3, :3] * RATE_HZ
    box, _ = pairs_inside(points.xyz_ego_m, boxes, margin_m=0.0)
    count = np.bincount(box, minlength=len(things))
    return FrameBoxes(boxes, velocity_mps, count, np.isin(things, truth.object_index))
