"""Exact labels and flow of the made-up drives, for evaluation only."""

from __future__ import annotations

import numpy as np

from upvl_cli.datasets.exact_labels import FrameBoxes, exact_labels
from upvl_cli.datasets.flow_truth import FlowTruth
from upvl_cli.geometry.boxes import pairs_inside, transform
from upvl_cli.geometry.se3 import inverse
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.kind import CYCLIST, OTHER, PEDESTRIAN, VEHICLE, Kind
from upvl_cli.synthetic.kinds import CARS
from upvl_cli.synthetic.piece import STUFF
from upvl_cli.types import Array, Bools, Boxes, Ints, Labels

GROUND_NAMES = ("road", "lane marking", "crosswalk", "kerb", "pavement", "grass")


class CityLabels:
    """Labels of the made-up drives (a `LabelSource`)."""

    def __init__(self, dataset: City) -> None:
        """Offer the labels of these drives."""
        self._dataset = dataset

    def labels(self, segment: str) -> Labels:
        """Return the boxes of all road users that the LiDAR ever sees, in all frames."""
        drive = self._dataset.open(segment)
        things = np.array(
            [n for n, thing in enumerate(drive.scene.things) if is_labelled(thing.kind)], dtype=np.int64
        )
        frames = [frame_boxes(drive, frame.index, things) for frame in drive.frames]
        kinds = [drive.scene.things[thing].kind for thing in things]
        return exact_labels(
            drive.frames, frames, things, [kind.name for kind in kinds], [kind.type for kind in kinds]
        )

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


class CityFlow:
    """The true flow of the made-up drives."""

    def __init__(self, dataset: City) -> None:
        """Offer the flow of these drives."""
        self._dataset = dataset

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """Return the true motion of the points of a sweep."""
        drive = self._dataset.open(segment)
        _, truth = drive.points_with_truth(frame)
        stuff = [-1 if name in GROUND_NAMES else 0 for name in STUFF]
        of_kind = {thing.kind.name: flow_class(thing.kind) for thing in drive.scene.things}
        of_name = np.array([*stuff, *(of_kind[name] for name in drive.scene.names[len(stuff) :])])
        return FlowTruth(truth.velocity_mps, of_name[truth.name])


def is_labelled(kind: Kind) -> bool:
    """Return whether a kind has labels: all road users, and what moves by itself."""
    return kind.type != OTHER or kind.speed_mps[1] > 0


def flow_class(kind: Kind) -> int:
    """Return the index of a kind in `FLOW_CLASSES`."""
    if kind.type == VEHICLE:
        return 1 if kind.name in CARS else 2
    return {PEDESTRIAN: 3, CYCLIST: 4}.get(kind.type, 0)


def frame_boxes(drive: CityDrive, frame: int, things: Ints) -> FrameBoxes:
    """Return the boxes of things in one frame, their velocities, points inside, and which gave points."""
    points, truth = drive.points_with_truth(frame)
    center, size, velocity = np.zeros((3, len(things), 3))
    heading = np.zeros(len(things))
    time_s = np.array([frame, frame + 1]) / drive.rate_hz
    for row, number in enumerate(things):
        thing = drive.scene.things[number]
        placed = thing.motion.at(time_s)
        height = thing.model.size_lwh_m[2]
        center[row] = placed.world(np.tile([0, 0, height / 2], (2, 1)))[0]
        size[row] = thing.model.size_lwh_m
        heading[row] = np.arctan2(placed.rotation[0, 1, 0], placed.rotation[0, 0, 0])
        velocity[row] = (placed.place_m[-1] - placed.place_m[0]) * drive.rate_hz
    pose = drive.world_from_ego[frame]
    boxes = transform(Boxes(center, size, heading), inverse(pose))
    box, _ = pairs_inside(points.xyz_ego_m, boxes, margin_m=0.0)
    count = np.bincount(box, minlength=len(things))
    return FrameBoxes(boxes, velocity @ pose[:3, :3], count, np.isin(things, truth.thing))
