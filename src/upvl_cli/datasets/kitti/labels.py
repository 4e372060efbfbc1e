"""KITTI's human boxes, for evaluation only: of whole raw drives and sequences, or of single frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.drive import KittiDrive
from upvl_cli.datasets.kitti.objects import ObjectBoxes, read_objects, read_sequence_objects
from upvl_cli.datasets.kitti.tracklets import read_tracklets
from upvl_cli.datasets.shared.numbered_files import describe_files, numbered_files
from upvl_cli.datasets.shared.tracks import count_points, velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project
from upvl_cli.types import Array, Bools, Boxes, Ints, Labels, concat

# Waymo's numbers; a class that is not here ("Misc") is 0. View-of-Delft's names are in lower case. Its `rider` is
# the person on a vehicle, whose box lies inside that of the whole (`Cyclist`): as an object of its own it is none.
# A bicycle or a rack without a rider is none of Waymo's classes; what has a motor is a vehicle.
_TYPES = {
    **dict.fromkeys(("Car", "Van", "Truck", "Tram", "Bus"), 1),
    **dict.fromkeys(("truck", "motor", "moped_scooter", "vehicle_other"), 1),
    **dict.fromkeys(("Pedestrian", "Person", "Person (sitting)", "Person_sitting"), 2),
    "Cyclist": 4,
}
_SETS = {"odometry": "the odometry set", "kitti360": "KITTI-360"}
_LABELLED_CAMERAS = ("image_02", "image_2")  # KITTI labels what its left colour camera sees


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
        labels = _read(drive)
        labels = labels[np.isin(labels.frame, [frame.index for frame in drive.frames])]
        labels = _on_points(labels[np.argsort(labels.frame, kind="stable")], drive)
        labels = count_points(labels, drive)
        return replace(labels, velocity_mps=velocities_of_tracks(labels, drive.frames, drive.world_from_ego))

    def frames(self, segment: str) -> Ints:
        """Return the index of each frame that was labelled; of the others nothing is known."""
        drive = self._kitti.open(segment)
        known = np.array([frame.index for frame in drive.frames])
        if drive.layout == "tracking":
            _sequence_path(drive)
            return known
        if drive.layout == "raw" and _tracklets_path(drive).is_file():
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
        drive = self._kitti.open(segment)
        cameras = drive.calibration.cameras
        camera = next((cameras[name] for name in _LABELLED_CAMERAS if name in cameras), None)
        if camera is None:
            raise BadInput(
                f"{segment} has no calibration of {_LABELLED_CAMERAS[drive.layout in ('object', 'odometry')]}, so "
                f"what was labelled is unknown; {_missing_calibration(drive)}"
            )
        return project(camera, xyz_ego_m)[2]


def _read(drive: KittiDrive) -> Labels:
    if drive.layout == "tracking":
        return _sequence_objects(drive)
    if drive.layout == "raw" and _tracklets_path(drive).is_file():
        return _tracklets(drive)
    return _objects(drive)


def _tracklets_path(drive: KittiDrive) -> Path:
    return drive.folder / "tracklet_labels.xml"


def _object_files(drive: KittiDrive) -> dict[int, Path]:
    if drive.layout not in ("raw", "object"):
        raise BadInput(
            f"{drive.name} is a drive of {_SETS[drive.layout]}, of which upvl reads no boxes: nothing to score against"
        )
    folder = drive.folder / ("object_label_2" if drive.layout == "raw" else "label_2")
    files = numbered_files(folder, (".txt",))
    if not files:
        expected = "tracklet_labels.xml or object_label_2/*.txt" if drive.layout == "raw" else "label_2/*.txt"
        raise BadInput(f"{drive.folder} has no labels; expected {expected}")
    return files


def _sequence_path(drive: KittiDrive) -> Path:
    path = drive.folder.parent.parent / "label_02" / f"{drive.folder.name}.txt"
    if not path.is_file():
        raise BadInput(f"{drive.name} has no labels: {describe_files(path.parent)}; expected {path}")
    return path


def _tracklets(drive: KittiDrive) -> Labels:
    tracklets = read_tracklets(_tracklets_path(drive))
    frames = [tracklet.first_frame + np.arange(len(tracklet.boxes)) for tracklet in tracklets]
    class_names = [tracklet.class_name for tracklet in tracklets for _ in range(len(tracklet.boxes))]
    ids = [str(number) for number, tracklet in enumerate(tracklets) for _ in range(len(tracklet.boxes))]
    return _labels(frames, [tracklet.boxes for tracklet in tracklets], class_names, ids)


def _objects(drive: KittiDrive) -> Labels:
    known = {frame.index for frame in drive.frames}
    files = {frame: path for frame, path in _object_files(drive).items() if frame in known}
    ego_from_rect = _ego_from_rect(drive)
    found: dict[int, ObjectBoxes] = {
        frame: read_objects(path, ego_from_rect, turns_about_lidar=drive.is_view_of_delft)
        for frame, path in files.items()
    }
    frames = [np.full(len(objects.boxes), frame) for frame, objects in found.items()]
    class_names = [name for objects in found.values() for name in objects.class_names]
    # The files name no object, so an object of each frame is another one.
    ids = [f"{frame}-{number}" for frame, objects in found.items() for number in objects.ids.tolist()]
    return _labels(frames, [objects.boxes for objects in found.values()], class_names, ids)


def _sequence_objects(drive: KittiDrive) -> Labels:
    objects = read_sequence_objects(_sequence_path(drive), _ego_from_rect(drive))
    ids = [str(number) for number in objects.ids.tolist()]
    return _labels([objects.frames], [objects.boxes], objects.class_names, ids)


def _ego_from_rect(drive: KittiDrive) -> Array:
    if drive.calibration.rect_from_ego is None:
        raise BadInput(f"the labels of {drive.name} are in camera axes; {_missing_calibration(drive)}")
    return np.linalg.inv(drive.calibration.rect_from_ego)


def _missing_calibration(drive: KittiDrive) -> str:
    if drive.layout == "raw":
        return "put calib_cam_to_cam.txt and calib_velo_to_cam.txt beside the drive"
    return "put its calibration file where the data set has it (calib)"


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


def _on_points(labels: Labels, drive: KittiDrive) -> Labels:
    """Return the boxes moved as the points that they were drawn around."""
    center_m = labels.center_m.copy()
    for frame in np.unique(labels.frame).tolist():
        here = labels.frame == frame
        center_m[here] = drive.untwist(frame, center_m[here])
    return replace(labels, center_m=center_m)
