"""Waymo's human boxes, for evaluation only: the component `lidar_box` of v2, the laser labels of v1."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared import arrow
from upvl_cli.datasets.waymo.components import SEGMENT, TIME, component_path, in_segment
from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.drive import WaymoDrive
from upvl_cli.datasets.waymo.frame_records import RecordSegment
from upvl_cli.datasets.waymo.names import TYPES
from upvl_cli.datasets.waymo.records import Record
from upvl_cli.datasets.waymo.wire import Message
from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.geometry.se3 import apply, inverse, rotate, wrap_angle
from upvl_cli.types import Array, Bools, Boxes, Ints, Labels, concat, empty

_ID = "key.laser_object_id"
_BOX = "[LiDARBoxComponent]."
_CENTER = [f"{_BOX}box.center.{axis}" for axis in "xyz"]
_SIZE = [f"{_BOX}box.size.{axis}" for axis in "xyz"]
_HEADING, _TYPE = f"{_BOX}box.heading", f"{_BOX}type"
_COUNT, _DIFFICULTY = f"{_BOX}num_lidar_points_in_box", f"{_BOX}difficulty_level.detection"
_SPEED = [f"{_BOX}speed.{axis}" for axis in "xyz"]
_OPTIONAL = [_COUNT, _DIFFICULTY, *_SPEED]

# Field numbers of the messages `Frame`, `Label` and `Polygon2dProto`.
_LASER_LABELS, _NO_LABEL_ZONES = 6, 7
_L_BOX, _L_METADATA, _L_TYPE, _L_ID, _L_DIFFICULTY, _L_COUNT = 1, 2, 3, 4, 5, 7
_L_BOX_FIELDS = (1, 2, 3, 5, 4, 6, 7)  # center_x, y, z, length, width, height, heading
_L_SPEED_FIELDS = (1, 2, 5)

_MAX_M, _MAX_MPS = 1e4, 1e3


class WaymoLabels:
    """The human boxes and no-label zones of the segments that `Waymo` finds below the same folder."""

    def __init__(self, root: Path) -> None:
        """Find the segments.

        Args:
            root: The folder that the data set was opened with.
        """
        self._waymo = Waymo(root)
        self._drive: WaymoDrive | None = None

    def _open(self, segment: str) -> WaymoDrive:
        if self._drive is None or self._drive.name != segment:
            self._drive = self._waymo.open(segment)
        return self._drive

    def labels(self, segment: str) -> Labels:
        """Return all boxes of the frames that the drive has, in the order of the frames.

        Args:
            segment: Name of the segment.

        Raises:
            BadInput: It has no labels, or they are damaged.
        """
        drive = self._open(segment)
        if isinstance(drive.source, RecordSegment):
            labels = _record_labels(drive, drive.source)
        else:
            labels = _component_labels(drive, self._box_path(segment))
        return _checked(labels[np.argsort(labels.frame, kind="stable")], segment)

    def frames(self, segment: str) -> Ints:
        """Return the index of every frame: all are labelled, also those without a box.

        Args:
            segment: Name of the segment.

        Raises:
            BadInput: It has no labels.
        """
        drive = self._open(segment)
        if isinstance(drive.source, RecordSegment):
            if not any(_LASER_LABELS in record.fields for record in drive.source.records.values()):
                raise BadInput(
                    f"{drive.source.where} has no labels; those of Waymo's test split are not public"
                )
        else:
            self._box_path(segment)
        return np.array([frame.index for frame in drive.frames])

    def _box_path(self, segment: str) -> Path:
        folder = self._waymo.path(segment).parents[1]
        path = component_path(folder, "lidar_box", segment)
        if path is None:
            raise BadInput(
                f"{folder / 'lidar_box' / segment}.parquet is missing: the segment has no labels (those of Waymo's "
                "test split are not public); get the component lidar_box"
            )
        return path

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return that every place was labelled: zones without labels are `unlabelled`.

        Args:
            segment: Name of the segment.
            xyz_ego_m: (n, 3) places in ego axes.
        """
        return np.ones(len(xyz_ego_m), dtype=np.bool_)

    def unlabelled(self, segment: str, frame: int, boxes: Boxes) -> Bools:
        """Return whether each box overlaps a zone that people left without labels.

        That is one with a point inside that Waymo marks so (channel 3 of the range images), or, in v1, with its
        centre in a polygon of the frame. Waymo has no code that derives this.

        Args:
            segment: Name of the segment.
            frame: Index of the frame.
            boxes: n boxes in ego axes.

        Raises:
            BadInput: The frame cannot be read.
        """
        drive = self._open(segment)
        found = np.zeros(len(boxes), dtype=np.bool_)
        if not len(boxes):
            return found
        stamp = drive.timestamps_us[frame]
        if stamp in drive.source.sweeps:
            marked = [item.xyz_ego_m[item.in_no_label_zone] for item in drive.returns(frame)]
            box, _ = pairs_inside(np.concatenate([*marked, np.zeros((0, 3))]), boxes, margin_m=0.0)
            found[box] = True
        if isinstance(drive.source, RecordSegment):
            center_m = apply(drive.source.poses[stamp], boxes.center_m)[:, :2]
            for polygon in _polygons(drive.source.records[stamp]):
                found |= _in_polygon(center_m, polygon)
        return found


def _component_labels(drive: WaymoDrive, path: Path) -> Labels:
    """Return the labels of v2; rows of other frames are left out."""
    table = arrow.read_parquet(path, [SEGMENT, TIME, _ID, *_CENTER, *_SIZE, _HEADING, _TYPE], _OPTIONAL)
    index = {stamp: frame for frame, stamp in drive.timestamps_us.items()}
    times_us = arrow.values(table, TIME, "int64", path).tolist()
    rows = np.flatnonzero(in_segment(table, drive.name, path) & [stamp in index for stamp in times_us])

    def column(name: str, missing: float = np.nan) -> Array:
        if name not in table.column_names:
            return np.full(len(rows), missing)
        found = arrow.floats_or_nan(table, name, path)[rows]
        return np.where(np.isnan(found), missing, found)

    frame = np.array([index[times_us[row]] for row in rows], dtype=np.int64)
    ids = arrow.texts(table, _ID, path)
    names = [*_CENTER, *_SIZE, _HEADING]
    speed = np.stack([column(name) for name in _SPEED], axis=1)
    speed[np.isnan(speed[:, 2]), 2] = 0.0  # v1 once had no vertical speed
    return _labels(
        drive,
        np.stack([column(name) for name in names], axis=1),
        frame=frame,
        object_id=[ids[row] for row in rows],
        kind=column(_TYPE, 0),
        speed_world_mps=speed,
        num_points=column(_COUNT, -1),
        difficulty=column(_DIFFICULTY, 0),
    )


def _record_labels(drive: WaymoDrive, source: RecordSegment) -> Labels:
    """Return the labels of v1."""
    parts = [
        _frame_labels(drive, frame, source.records[stamp]) for frame, stamp in drive.timestamps_us.items()
    ]
    return concat(parts, Labels)


def _frame_labels(drive: WaymoDrive, frame: int, record: Record) -> Labels:
    messages = [Message(content, f"{record.where}, label") for content in record.read(_LASER_LABELS)]
    if not messages:
        return empty(Labels)
    boxes, speeds = [], []
    for message in messages:
        box = message.message(_L_BOX)
        boxes.append([box.double(field) for field in _L_BOX_FIELDS])
        metadata = message.message(_L_METADATA)
        known = _L_METADATA in message
        speeds.append([metadata.double(field) if known else np.nan for field in _L_SPEED_FIELDS])
    return _labels(
        drive,
        np.array(boxes),
        frame=np.full(len(messages), frame),
        object_id=[message.text(_L_ID) for message in messages],
        kind=np.array([message.number(_L_TYPE) for message in messages], dtype=np.float64),
        speed_world_mps=np.array(speeds),
        num_points=np.array(
            [message.number(_L_COUNT) if _L_COUNT in message else -1 for message in messages],
            dtype=np.float64,
        ),
        difficulty=np.array([message.number(_L_DIFFICULTY) for message in messages], dtype=np.float64),
    )


def _labels(
    drive: WaymoDrive,
    rows: Array,
    *,
    frame: Ints,
    object_id: list[str],
    kind: Array,
    speed_world_mps: Array,
    num_points: Array,
    difficulty: Array,
) -> Labels:
    where = f"{drive.source.where}: the labels of the segment {drive.name}"
    if not np.isin(kind, list(TYPES)).all() or not np.isin(difficulty, [0, 1, 2]).all():
        raise BadInput(f"{where} have a type or a difficulty that Waymo has not; copy the file again")
    if not np.abs(rows).max(initial=0) <= _MAX_M or not (rows[:, 3:6] > 0).all():
        raise BadInput(
            f"{where} have a box without size, or farther than {_MAX_M:g} m away; copy the file again"
        )
    if np.nanmax(np.abs(speed_world_mps), initial=0.0) > _MAX_MPS or np.abs(num_points).max(initial=0) > 1e9:
        raise BadInput(f"{where} have a speed or a count of points that cannot be; copy the file again")
    poses = {step.index: pose for step, pose in zip(drive.frames, _poses(drive), strict=True)}
    ego_from_world = inverse(np.array([poses[index] for index in frame.tolist()]).reshape(-1, 4, 4))
    return Labels(
        rows[:, :3],
        rows[:, 3:6],
        np.where(np.abs(rows[:, 6]) <= np.pi, rows[:, 6], wrap_angle(rows[:, 6])),
        frame=frame,
        object_id=np.array(object_id, dtype=str),
        class_name=np.array([TYPES[int(number)] for number in kind], dtype=str),
        type=kind,
        velocity_mps=rotate(ego_from_world, speed_world_mps[:, None])[:, 0],
        num_points=num_points,
        difficulty=difficulty,
    )


def _poses(drive: WaymoDrive) -> Array:
    assert drive.world_from_ego is not None
    return drive.world_from_ego


def _checked(labels: Labels, segment: str) -> Labels:
    """Return the labels; raises `BadInput` where an object has two boxes in a frame."""
    pairs = list(zip(labels.frame.tolist(), labels.object_id.tolist(), strict=True))
    if len(set(pairs)) < len(pairs):
        raise BadInput(
            f"{segment}: {len(pairs) - len(set(pairs))} boxes are second ones of an object in a frame, expected "
            "one; copy the labels again"
        )
    return labels


def _polygons(record: Record) -> list[Array]:
    """Return the (n, 2) corners in the world of each zone without labels of a frame."""
    found = []
    for content in record.read(_NO_LABEL_ZONES):
        message = Message(content, f"{record.where}, no-label zone")
        x, y = message.doubles(1), message.doubles(2)
        if len(x) != len(y):
            raise message.damage(f"it has {len(x)} x and {len(y)} y")
        found.append(np.stack([x, y], axis=1))
    return found


def _in_polygon(points: Array, corners: Array) -> Bools:
    """Return (n,) whether points lie in a polygon, by the number of edges to the right; it need not be convex."""
    inside = np.zeros(len(points), dtype=np.bool_)
    for (x_a, y_a), (x_b, y_b) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y_a > points[:, 1]) != (y_b > points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            edge_x = x_a + (points[:, 1] - y_a) / (y_b - y_a) * (x_b - x_a)
        inside ^= crosses & (points[:, 0] < edge_x)
    return inside
