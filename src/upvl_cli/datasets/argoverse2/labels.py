"""Human boxes of Argoverse 2, for evaluation only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.datasets.argoverse2.dataset import Argoverse2
from upvl_cli.datasets.argoverse2.drive import ArgoverseDrive
from upvl_cli.datasets.argoverse2.poses import QUATERNION, TRANSLATION, poses_at
from upvl_cli.datasets.shared.arrow import read_feather, texts, values
from upvl_cli.datasets.shared.poses import quaternion_rotation, rigid
from upvl_cli.datasets.shared.tracks import velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import wrap_angle, yaw_of
from upvl_cli.types import Array, Bools, Frame, Ints, Labels

ANNOTATIONS = "annotations.feather"
# Waymo's numbers, by Waymo's rules: who rides a scooter or sits in a wheelchair is a pedestrian, motorcycles are
# vehicles, and a bicycle without a rider is nothing. A category that is not here is 0.
_VEHICLES = (
    "REGULAR_VEHICLE", "LARGE_VEHICLE", "BUS", "BOX_TRUCK", "TRUCK", "TRUCK_CAB", "VEHICULAR_TRAILER", "SCHOOL_BUS",
    "ARTICULATED_BUS", "RAILED_VEHICLE", "MESSAGE_BOARD_TRAILER", "TRAFFIC_LIGHT_TRAILER", "MOTORCYCLE",
    "MOTORCYCLIST",
)  # fmt: skip
_TYPES = {
    **dict.fromkeys(_VEHICLES, 1),
    **dict.fromkeys(("PEDESTRIAN", "WHEELCHAIR", "STROLLER", "OFFICIAL_SIGNALER", "WHEELED_RIDER"), 2),
    # The last two are one: its name in the data, and in their description.
    **dict.fromkeys(("SIGN", "STOP_SIGN", "MOBILE_PEDESTRIAN_CROSSING_SIGN", "MOBILE_PEDESTRIAN_SIGN"), 3),
    "BICYCLIST": 4,
}
_SIZE = ("length_m", "width_m", "height_m")
_MAX_M = 1e4


class ArgoverseLabels:
    """The boxes of the logs of a dataset: objects within 5 m of the drivable area, at any distance."""

    def __init__(self, dataset: Argoverse2) -> None:
        self._dataset = dataset

    def labels(self, segment: str) -> Labels:
        """Return all boxes of the frames that the log has; raises `BadInput` where it has none."""
        drive = self._dataset.open(segment)
        time_ns, labels = _read(drive)
        index = {frame.time_ns: frame.index for frame in drive.frames}
        with_sweep = np.array([time in index for time in time_ns.tolist()], dtype=np.bool_)
        frame = [index[time] for time in time_ns[with_sweep].tolist()]
        labels = replace(labels[with_sweep], frame=np.array(frame, dtype=np.int64))
        return labels[np.lexsort((labels.object_id, labels.frame))]

    def frames(self, segment: str) -> Ints:
        """Return the index of each frame that has a box; raises `BadInput` where the log has no labels."""
        drive = self._dataset.open(segment)
        path = _path(drive)
        times = values(read_feather(path, ("timestamp_ns",)), "timestamp_ns", "int64", path)
        index = np.array([frame.index for frame in drive.frames])
        return index[np.isin([frame.time_ns for frame in drive.frames], times)]

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return true for each place: labels reach as far as the LiDAR, all round."""
        return np.ones(len(xyz_ego_m), dtype=np.bool_)


def _path(drive: ArgoverseDrive) -> Path:
    path = drive.folder / ANNOTATIONS
    if not path.is_file():
        raise BadInput(
            f"{drive.folder} has no labels; expected {ANNOTATIONS}, which logs of the test split lack"
        )
    return path


def _read(drive: ArgoverseDrive) -> tuple[Array, Labels]:
    """Return (n,) times and the boxes at them; `frame` numbers the times."""
    path = _path(drive)
    columns = ("timestamp_ns", "track_uuid", "category", *_SIZE, *QUATERNION, *TRANSLATION)
    table = read_feather(path, columns, ("num_interior_pts",))
    time_ns = values(table, "timestamp_ns", "int64", path)
    size_m = np.stack([values(table, name, "float64", path) for name in _SIZE], axis=-1)
    center_m = np.stack([values(table, name, "float64", path) for name in TRANSLATION], axis=-1)
    wxyz = np.stack([values(table, name, "float64", path) for name in QUATERNION], axis=-1)
    wrong = ~((size_m > 0) & (size_m <= _MAX_M) & (np.abs(center_m) <= _MAX_M)).all(axis=1)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise BadInput(
            f"{path}: row {row} is a box of {' x '.join(f'{size:g}' for size in size_m[row])} m at "
            f"{', '.join(f'{place:g}' for place in center_m[row])} m; copy it again"
        )
    rotation = rigid(quaternion_rotation(wxyz, f"{path}: a rotation"), center_m)
    times, number = np.unique(time_ns, return_inverse=True)
    ids, names = texts(table, "track_uuid", path), texts(table, "category", path)
    if len(set(zip(number.tolist(), ids, strict=True))) < len(ids):
        raise BadInput(f"{path} has two boxes of one track_uuid at one time, expected one; copy it again")
    has_count = "num_interior_pts" in table.column_names
    labels = Labels(
        center_m,
        size_m,
        wrap_angle(yaw_of(rotation)),
        frame=number,
        object_id=np.array(ids, dtype=str),
        class_name=np.array(names, dtype=str),
        type=np.array([_TYPES.get(name, 0) for name in names]),
        velocity_mps=np.full((len(ids), 3), np.nan),
        num_points=values(table, "num_interior_pts", "int64", path) if has_count else np.full(len(ids), -1),
        difficulty=np.zeros(len(ids)),
    )
    return time_ns, replace(labels, velocity_mps=_velocities(labels, times, drive))


def _velocities(labels: Labels, times_ns: Array, drive: ArgoverseDrive) -> Array:
    """Return (n, 3) velocities from the boxes of each track, also those at times without a sweep."""
    velocity = np.full((len(labels), 3), np.nan)
    if drive.trajectory is not None:
        poses, known = poses_at(drive.trajectory, times_ns)
        here = known[labels.frame]
        frames = [Frame(number, time_ns) for number, time_ns in enumerate(times_ns.tolist())]
        velocity[here] = velocities_of_tracks(labels[here], frames, poses)
    return velocity
