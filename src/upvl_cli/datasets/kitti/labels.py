"""KITTI's human boxes, for evaluation only: tracklets of a whole drive, or objects of single frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.drive import KittiDrive
from upvl_cli.datasets.kitti.files import numbered_files
from upvl_cli.datasets.kitti.objects import read_objects
from upvl_cli.datasets.kitti.tracklets import read_tracklets
from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array, Bools, Boxes, Ints, Labels, concat

# Waymo's numbers; a class that is not here ("Misc") is 0.
_TYPES = {
    **dict.fromkeys(("Car", "Van", "Truck", "Tram", "Bus"), 1),
    **dict.fromkeys(("Pedestrian", "Person", "Person (sitting)", "Person_sitting"), 2),
    "Cyclist": 4,
}
_LABELLED_CAMERA = "image_02"  # KITTI labels what its left colour camera sees


class KittiLabels:
    """The human boxes of the drives that `Kitti` finds below the same folder."""

    def __init__(self, root: Path) -> None:
        self._kitti = Kitti(root)

    def labels(self, segment: str) -> Labels:
        """Return all boxes of the frames that the drive has, in the order of the frames.

        Raises:
            BadInput: The drive has no labels, or a file is not what it has to be.
        """
        drive = self._kitti.open(segment)
        labels = _tracklets(drive) if _tracklets_path(drive).is_file() else _objects(drive)
        labels = labels[np.isin(labels.frame, [frame.index for frame in drive.frames])]
        labels = _on_points(labels[np.argsort(labels.frame, kind="stable")], drive)
        return replace(labels, velocity_mps=_velocities(labels, drive))

    def frames(self, segment: str) -> Ints:
        """Return the index of each frame that was labelled; of the others nothing is known."""
        drive = self._kitti.open(segment)
        known = np.array([frame.index for frame in drive.frames])
        if _tracklets_path(drive).is_file():
            return known
        return known[np.isin(known, list(_object_files(drive)))]

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return whether the left colour camera has each place in its picture, at any distance.

        Args:
            segment: Name of the drive.
            xyz_ego_m: (n, 3) places in ego axes.

        Raises:
            BadInput: The drive has no calibration.
        """
        camera = self._kitti.open(segment).calibration.cameras.get(_LABELLED_CAMERA)
        if camera is None:
            raise BadInput(
                f"{segment} has no calibration of {_LABELLED_CAMERA}, so what was labelled is unknown; "
                "put calib_cam_to_cam.txt and calib_velo_to_cam.txt beside the drive"
            )
        return project(camera, xyz_ego_m)[2]


def _tracklets_path(drive: KittiDrive) -> Path:
    return drive.folder / "tracklet_labels.xml"


def _object_files(drive: KittiDrive) -> dict[int, Path]:
    files = numbered_files(drive.folder / "object_label_2", ".txt")
    if not files:
        raise BadInput(f"{drive.folder} has no labels; expected tracklet_labels.xml or object_label_2/*.txt")
    return files


def _tracklets(drive: KittiDrive) -> Labels:
    tracklets = read_tracklets(_tracklets_path(drive))
    frames = [tracklet.first_frame + np.arange(len(tracklet.boxes)) for tracklet in tracklets]
    class_names = [tracklet.class_name for tracklet in tracklets for _ in range(len(tracklet.boxes))]
    ids = [str(number) for number, tracklet in enumerate(tracklets) for _ in range(len(tracklet.boxes))]
    return _labels(frames, [tracklet.boxes for tracklet in tracklets], class_names, ids)


def _objects(drive: KittiDrive) -> Labels:
    files = _object_files(drive)
    if drive.calibration.rect_from_ego is None:
        raise BadInput(
            f"{drive.folder}/object_label_2 is in camera axes; "
            "put calib_cam_to_cam.txt and calib_velo_to_cam.txt beside the drive"
        )
    ego_from_rect = np.linalg.inv(drive.calibration.rect_from_ego)
    found = {frame: read_objects(path, ego_from_rect) for frame, path in files.items()}
    frames = [np.full(len(boxes), frame) for frame, (_, boxes) in found.items()]
    class_names = [name for names, _ in found.values() for name in names]
    # The files name no object, so an object of each frame is another one.
    ids = [f"{frame}-{number}" for frame, (names, _) in found.items() for number in range(len(names))]
    return _labels(frames, [boxes for _, boxes in found.values()], class_names, ids)


def _labels(frames: list[Array], parts: list[Boxes], class_names: list[str], ids: list[str]) -> Labels:
    boxes = concat(parts, Boxes)
    return Labels(
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        frame=np.concatenate([*frames, np.empty(0)]),
        object_id=np.array(ids, dtype=str),
        class_name=np.array(class_names, dtype=str),
        type=np.array([_TYPES.get(name, 0) for name in class_names]),
        velocity_mps=np.full((len(boxes), 3), np.nan),
        num_points=np.full(len(boxes), -1),
        difficulty=np.zeros(len(boxes)),
    )


def _velocities(labels: Labels, drive: KittiDrive) -> Array:
    """Return (n, 3) velocities over ground between the neighboring frames of an object; NaN for a single frame."""
    if drive.world_from_ego is None or not len(labels):
        return labels.velocity_mps
    step = np.searchsorted([frame.index for frame in drive.frames], labels.frame)
    time_ns = np.array([frame.time_ns for frame in drive.frames])[step]
    world_from_ego = drive.world_from_ego[step]  # (n, 4, 4)
    center_world_m = apply(world_from_ego, labels.center_m[:, None])[:, 0]
    order = np.lexsort((labels.frame, labels.object_id))
    same = labels.object_id[order][1:] == labels.object_id[order][:-1]
    before, after = order.copy(), order.copy()
    before[1:][same], after[:-1][same] = order[:-1][same], order[1:][same]
    seconds = (time_ns[after] - time_ns[before]) / 1e9
    velocity = np.full((len(labels), 3), np.nan)
    moved = seconds > 0
    velocity[order[moved]] = (center_world_m[after] - center_world_m[before])[moved] / seconds[moved, None]
    return (velocity[:, None] @ world_from_ego[:, :3, :3])[:, 0]


def _on_points(labels: Labels, drive: KittiDrive) -> Labels:
    """Return the boxes moved as the points that they were drawn around, and how many points are inside."""
    center_m = labels.center_m.copy()
    count = np.zeros(len(labels), dtype=np.int64)
    for frame in np.unique(labels.frame).tolist():
        here = labels.frame == frame
        center_m[here] = drive.untwist(frame, center_m[here])
        boxes = Boxes(center_m[here], labels.size_lwh_m[here], labels.heading_rad[here])
        xyz_ego_m = drive.points(frame).xyz_ego_m
        count[here] = points_inside(xyz_ego_m, boxes, margin_m=0.0).sum(axis=1)
    return replace(labels, center_m=center_m, num_points=count)
