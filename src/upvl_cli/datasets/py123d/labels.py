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
from upvl_cli.datasets.py123d.library import library_errors, pose_matrices
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
        times_us = drive.log.times_us(_KEY)
        known = [frame.index for frame in drive.frames if times_us[frame.index] is not None]
        return np.array(known, dtype=np.int64)

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
    with library_errors(where):
        found = drive.log.scene.get_box_detections_se3_at_iteration(frame)
        boxes = [] if found is None else list(found.box_detections)
        boxes = [box for box in boxes if box.attributes.default_label != DefaultBoxDetectionLabel.EGO]
        tokens = [str(box.attributes.track_token) for box in boxes]
        names = [(str(box.attributes.label.name), str(box.attributes.default_label.name)) for box in boxes]
        # x, y, z, quaternion, length, width, height
        numbers = np.array([box.bounding_box_se3.array for box in boxes], dtype=np.float64).reshape(-1, 10)
        given = [np.full(3, np.nan) if box.velocity_3d is None else box.velocity_3d.array for box in boxes]
        velocity_mps = np.array(given, dtype=np.float64).reshape(-1, 3)
        counts = [box.attributes.num_lidar_points for box in boxes]
    _check_boxes(tokens, numbers[:, 7:], velocity_mps, where)
    world_from_box = pose_matrices(numbers[:, :7], f"{where}: box")
    poses = compose(inverse(world_from_ego), world_from_box)
    if np.abs(poses[:, :3, 3]).max(initial=0.0) > _MAX_M:
        raise BadInput(f"{where} has a box more than {_MAX_M:g} m away; convert the log again")
    return Labels(
        poses[:, :3, 3],
        numbers[:, 7:],
        yaw_of(poses),
        frame=np.full(len(boxes), frame),
        object_id=np.array(tokens, dtype=str),
        class_name=np.array([name for name, _ in names], dtype=str),
        type=np.array([type_of_class(name) or type_of_class(default) for name, default in names]),
        velocity_mps=velocity_mps @ world_from_ego[:3, :3],
        num_points=np.array([_num_points(count) for count in counts]),
        difficulty=np.zeros(len(boxes)),
    )


def _check_boxes(tokens: list[str], size_lwh_m: Array, velocity_mps: Array, where: str) -> None:
    if len(set(tokens)) < len(tokens):
        twice = next(token for token in tokens if tokens.count(token) > 1)
        raise BadInput(f"{where} has two boxes of track {twice[:60]!r}; convert the log again")
    wrong = np.flatnonzero(~((size_lwh_m > 0) & (size_lwh_m < _MAX_M)).all(axis=1))
    if len(wrong):
        size = size_lwh_m[wrong[0]].tolist()
        raise BadInput(f"{where} has a box of {size} m, expected length, width, height above 0")
    fast = np.flatnonzero((np.abs(velocity_mps) > _MAX_SPEED_MPS).any(axis=1))
    if len(fast):
        velocity = velocity_mps[fast[0]].tolist()
        raise BadInput(f"{where} has a box that moves at {velocity} m/s; check the unit")


def _num_points(count: Any) -> int:
    return count if isinstance(count, int) and 0 <= count < 2**40 else -1
