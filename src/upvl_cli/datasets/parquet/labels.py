"""The table `labels/<segment>.parquet`: human boxes, for evaluation only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from upvl_cli.datasets.parquet.drive import ParquetDrive
from upvl_cli.datasets.shared.arrow import (
    floats_or_nan,
    integers,
    metadata_text,
    open_parquet,
    read_parquet,
    texts,
    values,
)
from upvl_cli.datasets.shared.class_types import type_of_class
from upvl_cli.datasets.shared.tracks import count_points, velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array, Bools, Camera, Dataset, Ints, Labels

_BOX = ("center_x_m", "center_y_m", "center_z_m", "length_m", "width_m", "height_m", "heading_rad")
_VELOCITY = ("velocity_x_mps", "velocity_y_mps")
_MAX_M = 1e4  # a LiDAR sees a few hundred metres
_MAX_SPEED_MPS = 200.0
_MAX_HEADING_RAD = 100.0  # more turns than anybody adds up


@dataclass(frozen=True)
class LabelRegion:
    """Where objects were labelled.

    Attributes:
        range_m: Labels are complete up to this distance from the ego; None where nothing is said.
        camera: Only inside this camera's view; None where nothing is said.
    """

    range_m: float | None
    camera: str | None


class ParquetLabels:
    """The human boxes of the drives below a folder."""

    def __init__(self, root: Path, dataset: Dataset) -> None:
        """Take the folder and its opened drives."""
        self._root = root
        self._dataset = dataset
        self.labels = lru_cache(maxsize=4)(self._labels)

    def frames(self, segment: str) -> Ints:
        """Return the labelled frames: those with at least one box."""
        path = self._path(segment)
        table = read_parquet(path, ("frame",))
        known = [frame.index for frame in self._drive(segment).frames]
        return np.intersect1d(integers(table, "frame", path), known)

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return (n,) whether each place lies where objects were labelled, as the table's metadata say."""
        path = self._path(segment)
        region, xyz = self._region(path), np.asarray(xyz_ego_m, dtype=np.float64).reshape(-1, 3)
        covered = np.ones(len(xyz), dtype=np.bool_)
        if region.range_m is not None:
            covered &= np.hypot(xyz[:, 0], xyz[:, 1]) <= region.range_m
        if region.camera is not None:
            covered &= project(self._camera(segment, region.camera, path), xyz)[2]
        return covered

    def _labels(self, segment: str) -> Labels:
        """Return all boxes of the frames that the drive has; raises `BadInput` where it has no labels."""
        path = self._path(segment)
        table = read_parquet(path, ("frame", "track_id", "class", *_BOX), _VELOCITY)
        boxes = np.column_stack([values(table, name, "float64", path) for name in _BOX])
        _check_boxes(boxes, path)
        names = texts(table, "class", path)
        labels = Labels(
            boxes[:, :3],
            boxes[:, 3:6],
            wrap_angle(boxes[:, 6]),
            frame=integers(table, "frame", path),
            object_id=np.array(texts(table, "track_id", path), dtype=str),
            class_name=np.array(names, dtype=str),
            type=np.array([type_of_class(name) for name in names], dtype=np.int8),
            velocity_mps=np.full((len(boxes), 3), np.nan),
            num_points=np.full(len(boxes), -1),
            difficulty=np.zeros(len(boxes)),
        )
        _check_pairs(labels, path)
        given = [name for name in _VELOCITY if name in table.column_names]
        if len(given) == 1:
            raise BadInput(
                f"{path} has the column {given[0]} alone, expected both of {', '.join(_VELOCITY)} or none"
            )
        if given:
            velocity = np.column_stack(
                [*(floats_or_nan(table, name, path) for name in given), np.zeros(len(boxes))]
            )
            if np.nanmax(np.abs(velocity), initial=0.0) > _MAX_SPEED_MPS:
                raise BadInput(f"{path} has velocities above {_MAX_SPEED_MPS:g} m/s; check their unit")
            labels = replace(labels, velocity_mps=velocity)
        return self._complete(labels, self._drive(segment))

    def _complete(self, labels: Labels, drive: ParquetDrive) -> Labels:
        """Return the labels of the drive's frames with velocities and point counts."""
        labels = labels[np.isin(labels.frame, [frame.index for frame in drive.frames])]
        labels = labels[np.argsort(labels.frame, kind="stable")]
        unknown = np.isnan(labels.velocity_mps).any(axis=1, keepdims=True)
        from_tracks = velocities_of_tracks(labels, drive.frames, drive.world_from_ego)
        labels = replace(labels, velocity_mps=np.where(unknown, from_tracks, labels.velocity_mps))
        return count_points(labels, drive)

    def _path(self, segment: str) -> Path:
        path = self._root / "labels" / f"{segment}.parquet"
        if segment not in self._dataset.segments or not path.is_file():
            raise BadInput(f"{segment} has no labels; expected {path}")
        return path

    def _drive(self, segment: str) -> ParquetDrive:
        drive = self._dataset.open(segment)
        assert isinstance(drive, ParquetDrive)
        return drive

    def _region(self, path: Path) -> LabelRegion:
        metadata = open_parquet(path).metadata.metadata
        text = metadata_text(metadata, "region_range_m", path)
        try:
            range_m = None if text is None else float(text)
        except ValueError:
            range_m = -1.0
        if range_m is not None and not range_m > 0:
            raise BadInput(f"{path}: region_range_m is {str(text)[:40]!r}, expected a distance in metres")
        return LabelRegion(range_m, metadata_text(metadata, "region_camera", path))

    def _camera(self, segment: str, name: str, path: Path) -> Camera:
        cameras = self._drive(segment).cameras
        found = next((camera for camera in cameras if camera.name == name), None)
        if found is None:
            known = ", ".join(camera.name for camera in cameras) or "none"
            raise BadInput(f"{path}: region_camera is {name[:40]!r}, but the drive's cameras are {known}")
        return found


def _check_boxes(boxes: Array, path: Path) -> None:
    fine = np.isfinite(boxes).all(axis=1) & (boxes[:, 3:6] > 0).all(axis=1)
    fine &= np.abs(np.nan_to_num(boxes[:, :6], nan=np.inf)).max(axis=1, initial=0) <= _MAX_M
    fine &= np.abs(np.nan_to_num(boxes[:, 6], nan=np.inf)) <= _MAX_HEADING_RAD
    if not fine.all():
        row = int(np.flatnonzero(~fine)[0])
        raise BadInput(
            f"{path}, row {row} is no box: centre, size, heading {boxes[row].tolist()}; expected metres within "
            f"{_MAX_M:g} and radians, sizes above 0"
        )


def _check_pairs(labels: Labels, path: Path) -> None:
    order = np.lexsort((labels.object_id, labels.frame))
    frame, track = labels.frame[order], labels.object_id[order]
    twice = np.flatnonzero((frame[1:] == frame[:-1]) & (track[1:] == track[:-1]))
    if len(twice):
        raise BadInput(
            f"{path} has two boxes of track {str(track[twice[0]])[:60]!r} in frame {frame[twice[0]]}; keep one"
        )
