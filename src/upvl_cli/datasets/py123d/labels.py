"""The boxes of a log, for evaluation only."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from py123d.datatypes import ModalityType
from py123d.datatypes.detections import DefaultBoxDetectionLabel

from upvl_cli.datasets.py123d.drive import Py123dDrive
from upvl_cli.datasets.py123d.library import library_errors, pose_matrix
from upvl_cli.datasets.shared.class_types import type_of_class
from upvl_cli.datasets.shared.tracks import count_points, velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import compose, inverse, yaw_of
from upvl_cli.types import Array, Bools, Dataset, Ints, Labels, concat

_KEY = ModalityType.BOX_DETECTIONS_SE3.serialize()
_MAX_M = 1e4  # a LiDAR sees a few hundred metres
_MAX_SPEED_MPS = 200.0


class Py123dLabels:
    """The boxes of the logs below a folder."""

    def __init__(self, root: Path, dataset: Dataset) -> None:
        """Take the folder and its opened logs."""
        self._dataset = dataset
        self.labels = lru_cache(maxsize=4)(self._labels)

    def frames(self, segment: str) -> Ints:
        """Return the labelled frames: those with a row of boxes, be it an empty one."""
        drive = self._drive(segment)
        times = [drive.log.time_us(frame.index, _KEY) for frame in drive.frames]
        return np.array(
            [frame.index for frame, time in zip(drive.frames, times, strict=True) if time is not None],
            dtype=np.int64,
        )

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return (n,) true: a log does not say where objects were labelled."""
        return np.ones(len(np.asarray(xyz_ego_m).reshape(-1, 3)), dtype=np.bool_)

    def _labels(self, segment: str) -> Labels:
        """Return all boxes of the frames that the drive has; raises `BadInput` where it has no labels."""
        drive = self._drive(segment)
        poses = drive.world_from_ego
        assert poses is not None  # checked by _drive
        labels = concat(
            [
                _labels_of_frame(drive, frame.index, pose)
                for frame, pose in zip(drive.frames, poses, strict=True)
            ],
            Labels,
        )
        known = labels.num_points >= 0
        if not known.all():
            counted = count_points(labels, drive).num_points
            labels = replace(labels, num_points=np.where(known, labels.num_points, counted))
        unknown = np.isnan(labels.velocity_mps).any(axis=1, keepdims=True)
        from_tracks = velocities_of_tracks(labels, drive.frames, poses)
        return replace(labels, velocity_mps=np.where(unknown, from_tracks, labels.velocity_mps))

    def _drive(self, segment: str) -> Py123dDrive:
        drive = self._dataset.open(segment)
        assert isinstance(drive, Py123dDrive)
        if _KEY not in drive.log.metadatas:
            raise BadInput(f"{segment} has no labels that py123d can read; expected {drive.log.path(_KEY)}")
        if drive.world_from_ego is None:
            raise BadInput(
                f"{segment}: its labels are in the axes of the world, but it has no ego_state_se3.arrow to place them"
            )
        drive.log.table(_KEY)
        return drive


def _labels_of_frame(drive: Py123dDrive, frame: int, world_from_ego: Array) -> Labels:
    """Return the boxes of one frame in its ego axes."""
    where = f"{drive.log.path(_KEY)}, iteration {frame}"
    rows = []
    with library_errors(where):
        found = drive.log.scene.get_box_detections_se3_at_iteration(frame)
        for box in () if found is None else found.box_detections:
            label = box.attributes.label
            default = label.to_default()
            if default != DefaultBoxDetectionLabel.EGO:
                rows.append((box, str(label.name), str(default.name)))
    tokens = [str(box.attributes.track_token) for box, _, _ in rows]
    if len(set(tokens)) < len(tokens):
        twice = next(token for token in tokens if tokens.count(token) > 1)
        raise BadInput(f"{where} has two boxes of track {twice[:60]!r}; convert the log again")
    ego_from_world = inverse(world_from_ego)
    centers = [
        compose(ego_from_world, pose_matrix(box.center_se3, f"{where}, track {token[:60]!r}"))
        for (box, _, _), token in zip(rows, tokens, strict=True)
    ]
    poses = np.array(centers).reshape(-1, 4, 4)
    velocity = np.array([_velocity(box, where) for box, _, _ in rows]).reshape(-1, 3)
    sizes = np.array([_size(box, where) for box, _, _ in rows]).reshape(-1, 3)
    if np.abs(poses[:, :3, 3]).max(initial=0.0) > _MAX_M:
        raise BadInput(f"{where} has a box more than {_MAX_M:g} m away; convert the log again")
    names = [name for _, name, _ in rows]
    return Labels(
        poses[:, :3, 3],
        sizes,
        yaw_of(poses),
        frame=np.full(len(rows), frame),
        object_id=np.array(tokens, dtype=str),
        class_name=np.array(names, dtype=str),
        type=np.array([type_of_class(name) or type_of_class(default) for _, name, default in rows]),
        velocity_mps=velocity @ world_from_ego[:3, :3],
        num_points=np.array([_num_points(box) for box, _, _ in rows]),
        difficulty=np.zeros(len(rows)),
    )


def _size(box: Any, where: str) -> list[float]:
    with library_errors(where):
        shape = box.bounding_box_se3
        size = [float(shape.length), float(shape.width), float(shape.height)]
    if not all(0 < side < _MAX_M for side in size):
        raise BadInput(f"{where} has a box of {size} m, expected length, width, height above 0")
    return size


def _velocity(box: Any, where: str) -> Array:
    """Return (3,) velocity in the axes of the world; NaN where the log gives none."""
    with library_errors(where):
        given = box.velocity_3d
        velocity = np.full(3, np.nan) if given is None else np.array(given.array, dtype=np.float64)
    if velocity.shape != (3,) or np.nanmax(np.abs(velocity), initial=0.0) > _MAX_SPEED_MPS:
        raise BadInput(f"{where} has a box that moves at {velocity.tolist()} m/s; check the unit")
    return velocity


def _num_points(box: Any) -> int:
    count = box.attributes.num_lidar_points
    return int(count) if isinstance(count, int) and 0 <= count < 2**40 else -1
