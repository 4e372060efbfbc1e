"""A segment of Waymo's perception data set v2: one Parquet file for each component."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
import pyarrow as pa

from upvl_cli.datasets.shared import arrow
from upvl_cli.datasets.shared.parquet_columns import BytesColumn, ListColumn
from upvl_cli.datasets.shared.poses import check_pose
from upvl_cli.datasets.waymo.calibration import LaserCalibration, camera_calibration, laser_calibration
from upvl_cli.datasets.waymo.names import CAMERAS, LASERS, RETURNS
from upvl_cli.datasets.waymo.range_images import POSE_CHANNELS, PROJECTION_CHANNELS, RANGE_CHANNELS
from upvl_cli.datasets.waymo.source import LaserImage, check_shape
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools, Camera, Ints

SEGMENT = "key.segment_context_name"
TIME = "key.frame_timestamp_micros"
LASER, CAMERA = "key.laser_name", "key.camera_name"
POSE = "[VehiclePoseComponent].world_from_vehicle.transform"
_LASER_CALIBRATION = "[LiDARCalibrationComponent]."
_CAMERA_CALIBRATION = "[CameraCalibrationComponent]."
_IMAGE, _IMAGE_TIME = "[CameraImageComponent].image", "[CameraImageComponent].pose_timestamp"
_INTRINSIC = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
_NUMBER = {LASER: {name: key for key, name in LASERS.items()}, CAMERA: {v: k for k, v in CAMERAS.items()}}


def component_path(folder: Path, component: str, segment: str) -> Path | None:
    """Return the file of a component, with a suffix in any case, or None where it is missing.

    Args:
        folder: The folder of the split, which holds a folder for each component.
        component: Name of the component, for example "lidar".
        segment: Name of the segment.
    """
    for suffix in (".parquet", ".PARQUET", ".Parquet"):
        path = folder / component / f"{segment}{suffix}"
        if path.is_file():
            return path
    return None


def in_segment(table: pa.Table, segment: str, where: object) -> Bools:
    """Return (rows,) whether each row of a component belongs to a segment.

    Args:
        table: The table, with its column of segment names.
        segment: Name of the segment.
        where: The file, for messages.
    """
    names = arrow.texts(table, SEGMENT, where)
    return np.array([name == segment for name in names], dtype=np.bool_)


def numbers_of(table: pa.Table, key: str, where: object) -> Ints:
    """Return (rows,) Waymo's numbers of the lasers or cameras of a component, which can also be their names.

    Args:
        table: The table.
        key: `LASER` or `CAMERA`.
        where: The file, for messages.
    """
    kind = table[key].type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_dictionary(kind)):
        return arrow.values(table, key, "int64", where)
    names = arrow.texts(table, key, where)
    unknown = [name for name in names if name not in _NUMBER[key]]
    if unknown:
        raise BadInput(f"{where}: {key} is {unknown[0][:80]!r}, expected one of {', '.join(_NUMBER[key])}")
    return np.array([_NUMBER[key][name] for name in names], dtype=np.int64)


class KeyedRows:
    """Rows of a component by time stamp and number of laser or camera; files are not sorted."""

    def __init__(self, path: Path, key: str, segment: str, columns: Sequence[str] = ()) -> None:
        """Read the keys.

        Args:
            path: The file.
            key: `LASER` or `CAMERA`.
            segment: Rows of other segments do not count.
            columns: Further columns that are read if they are there.
        """
        self.path = path
        self.table = arrow.read_parquet(path, [SEGMENT, TIME, key], columns)
        times_us = arrow.values(self.table, TIME, "int64", path)
        numbers = numbers_of(self.table, key, path)
        rows = np.flatnonzero(in_segment(self.table, segment, path))
        pairs = zip(times_us[rows].tolist(), numbers[rows].tolist(), strict=True)
        self.row: dict[tuple[int, int], int] = {}
        for row, pair in zip(rows.tolist(), pairs, strict=True):
            if self.row.setdefault(pair, row) != row:
                raise BadInput(
                    f"{path}: rows {self.row[pair]} and {row} are both of {TIME} {pair[0]} and {key} {pair[1]}, "
                    "expected one; copy the file again"
                )

    @property
    def timestamps_us(self) -> frozenset[int]:
        """Times (us) that have a row."""
        return frozenset(stamp for stamp, _ in self.row)


class RangeImages:
    """The range images of one component, by return; each is read when it is asked for."""

    def __init__(self, path: Path, name: str, segment: str, channels: int) -> None:
        """Read the keys.

        Args:
            path: The file.
            name: Name of the component in its columns.
            segment: Name of the segment.
            channels: Values of each pixel.
        """
        self._prefix, self._channels = f"[{name}].range_image_return", channels
        shapes = [f"{self._prefix}{number}.shape" for number in (1, 2)]
        self.rows = KeyedRows(path, LASER, segment, shapes)
        self._frame_rows: dict[int, list[tuple[int, int]]] = {}
        for (stamp, laser), row in sorted(self.rows.row.items(), key=itemgetter(1)):
            self._frame_rows.setdefault(stamp, []).append((row, laser))
        self._columns: dict[int, tuple[ListColumn, Array] | None] = {}
        self._lock = threading.Lock()

    def images(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield laser, return and (height, width, channels) of a frame, in the order of the file.

        Two rows often share a page of the file: in this order it is read once.

        Args:
            timestamp_us: Time stamp of the frame.

        Raises:
            BadInput: The file is damaged.
        """
        for return_number in RETURNS:
            for row, laser in self._frame_rows.get(timestamp_us, []):
                image = self._read(row, return_number)
                if image is not None:
                    yield laser, return_number, image

    def _read(self, row: int, return_number: int) -> Array | None:
        with self._lock:
            if return_number not in self._columns:
                self._columns[return_number] = self._open(return_number)
        opened = self._columns[return_number]
        if opened is None or not opened[1][row].any():
            return None
        column, shapes = opened
        where = f"{self.rows.path}, row {row}: return {return_number}"
        shape = check_shape(tuple(shapes[row].tolist()), self._channels, where)
        values = column.row(row)
        return None if values is None else values.reshape(shape)

    def _open(self, return_number: int) -> tuple[ListColumn, Array] | None:
        name = f"{self._prefix}{return_number}.shape"
        if name not in self.rows.table.column_names:
            return None
        cells = self.rows.table[name]
        present = cells.is_valid().to_numpy(zero_copy_only=False).astype(np.bool_)
        shapes = np.zeros((len(cells), 3), np.int64)
        if present.any():
            found = arrow.matrices(pa.table({name: cells.drop_null()}), name, 3, self.rows.path)
            assert found is not None
            if not (np.abs(found) < 2**20).all():
                raise BadInput(
                    f"{self.rows.path}: {name} holds sizes of {np.abs(found).max():g}; copy it again"
                )
            shapes[present] = found
        count = shapes.prod(axis=1)
        return ListColumn(self.rows.path, f"{self._prefix}{return_number}.values", count), shapes


class ComponentSegment:
    """One segment of v2 (a `SegmentSource`). Only keys and small components are read when it is opened."""

    def __init__(self, folder: Path, segment: str) -> None:
        """Open a segment.

        Args:
            folder: The folder of the split, which holds a folder for each component.
            segment: Name of the segment.

        Raises:
            BadInput: A component is damaged.
        """
        self._segment = segment
        paths: dict[str, Path | None] = {
            name: component_path(folder, name, segment)
            for name in (
                "vehicle_pose",
                "lidar",
                "lidar_pose",
                "lidar_camera_projection",
                "lidar_calibration",
                "camera_calibration",
                "camera_image",
            )
        }
        pose_path = paths["vehicle_pose"]
        if pose_path is None:
            raise BadInput(f"{folder / 'vehicle_pose' / segment}.parquet is missing; copy it again")
        self.where = str(pose_path)
        self.files = tuple(path for path in paths.values() if path is not None)
        self.poses = _poses(pose_path, segment)
        path = paths["lidar_calibration"]
        self.lasers = _lasers(path, segment) if path else {}
        path = paths["camera_calibration"]
        self.cameras = _cameras(path, segment) if path else {}
        self._ranges = self._range_images(paths["lidar"], "LiDARComponent", RANGE_CHANNELS)
        self._pixel_poses = self._range_images(paths["lidar_pose"], "LiDARPoseComponent", POSE_CHANNELS)
        self._projections = self._range_images(
            paths["lidar_camera_projection"], "LiDARCameraProjectionComponent", PROJECTION_CHANNELS
        )
        self.has_projections = self._projections is not None
        self.sweeps = self._ranges.rows.timestamps_us if self._ranges else frozenset()
        if self.sweeps and not self.lasers:
            raise BadInput(
                f"{folder / 'lidar_calibration'} lacks the segment {segment}, without which its range images are "
                "no points; copy it too"
            )
        path = paths["camera_image"]
        self._pictures = KeyedRows(path, CAMERA, segment, [_IMAGE_TIME]) if path else None
        self._picture_column = BytesColumn(path, _IMAGE) if path else None
        self.skipped = self._skipped()

    def _range_images(self, path: Path | None, name: str, channels: int) -> RangeImages | None:
        return RangeImages(path, name, self._segment, channels) if path else None

    def _skipped(self) -> Mapping[str, int]:
        skipped: Counter[str] = Counter()
        for stamp, camera in self._pictures.row if self._pictures else ():
            if stamp not in self.poses:
                skipped["picture without a frame"] += 1
            elif camera not in self.cameras:
                skipped["picture of a camera without calibration"] += 1
        if self._ranges:
            lasers = [laser for _, laser in self._ranges.rows.row]
            skipped["range image of a laser without calibration"] += sum(
                laser not in self.lasers for laser in lasers
            )
        return skipped

    def range_images(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 4) of each return of a frame, in the order of the file."""
        return self._ranges.images(timestamp_us) if self._ranges else iter(())

    def pixel_poses(self, timestamp_us: int, laser: int) -> Array | None:
        """Return (height, width, 6), or None where it is missing."""
        found = self._pixel_poses.images(timestamp_us) if self._pixel_poses else iter(())
        return next((image for number, _, image in found if number == laser), None)

    def projections(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 6) of each return of a frame, in the order of the file."""
        return self._projections.images(timestamp_us) if self._projections else iter(())

    def picture(self, timestamp_us: int, camera: int) -> tuple[bytes, float] | None:
        """Return the JPEG and the time of its pose (s; NaN where unknown), or None where it is missing."""
        if self._pictures is None or self._picture_column is None:
            return None
        row = self._pictures.row.get((timestamp_us, camera))
        content = None if row is None else self._picture_column.row(row)
        if row is None or content is None:
            return None
        table, time_s = self._pictures.table, np.nan
        if _IMAGE_TIME in table.column_names:
            time_s = float(arrow.floats_or_nan(table.slice(row, 1), _IMAGE_TIME, self._pictures.path)[0])
        return content, time_s


def _poses(path: Path, segment: str) -> dict[int, Array]:
    table = arrow.read_parquet(path, [SEGMENT, TIME, POSE])
    times_us = arrow.values(table, TIME, "int64", path)
    numbers = _matrices(table, POSE, path)
    rows = np.flatnonzero(in_segment(table, segment, path))
    if len(rows) < len(times_us) and not len(rows):
        raise BadInput(
            f"{path} holds no row of the segment {segment}; its name must be the segment's: rename it"
        )
    poses = check_pose(numbers[rows].reshape(-1, 4, 4), f"{path}: {POSE}, row")
    found = dict(zip(times_us[rows].tolist(), poses, strict=True))
    if len(found) < len(rows):
        raise BadInput(f"{path}: {len(rows)} rows have {len(found)} time stamps, expected one pose a frame")
    return found


def _matrices(table: pa.Table, name: str, path: Path) -> Array:
    """Return the (rows, 16) numbers of a column of transforms."""
    numbers = arrow.matrices(table, name, 16, path)
    if numbers is None:
        raise BadInput(f"{path}: the column {name} is empty, expected 16 numbers in each row; copy it again")
    return numbers


def _lasers(path: Path, segment: str) -> dict[int, LaserCalibration]:
    prefix = f"{_LASER_CALIBRATION}beam_inclination."
    extrinsic, beams = f"{_LASER_CALIBRATION}extrinsic.transform", f"{prefix}values"
    edges = [f"{prefix}min", f"{prefix}max"]
    table = arrow.read_parquet(path, [SEGMENT, LASER, extrinsic], [*edges, beams])
    numbers = numbers_of(table, LASER, path)
    transforms = _matrices(table, extrinsic, path)
    edges_rad = [
        arrow.floats_or_nan(table, name, path)
        if name in table.column_names
        else np.full(len(numbers), np.nan)
        for name in edges
    ]
    found = {}
    for row in np.flatnonzero(in_segment(table, segment, path)).tolist():
        beams_rad = None
        if beams in table.column_names and table[beams][row].is_valid:
            cell = arrow.list_cell(table[beams], row, "float64", f"{path}: {beams}")
            beams_rad = cell if len(cell) else None
        edge = (float(edges_rad[0][row]), float(edges_rad[1][row]))
        number = int(numbers[row])
        found[number] = laser_calibration(number, transforms[row], edge, beams_rad, str(path))
    return found


def _cameras(path: Path, segment: str) -> dict[int, Camera]:
    names = [f"{_CAMERA_CALIBRATION}intrinsic.{name}" for name in _INTRINSIC]
    extrinsic = f"{_CAMERA_CALIBRATION}extrinsic.transform"
    sizes = [f"{_CAMERA_CALIBRATION}{name}" for name in ("width", "height")]
    table = arrow.read_parquet(path, [SEGMENT, CAMERA, *names, extrinsic, *sizes])
    numbers = numbers_of(table, CAMERA, path)
    transforms = _matrices(table, extrinsic, path)
    intrinsic = np.array([arrow.values(table, name, "float64", path) for name in names]).T
    size_px = [arrow.values(table, name, "float64", path) for name in sizes]
    found = {}
    for row in np.flatnonzero(in_segment(table, segment, path)).tolist():
        number, size = int(numbers[row]), (float(size_px[0][row]), float(size_px[1][row]))
        found[number] = camera_calibration(number, intrinsic[row], transforms[row], size, str(path))
    return found
