"""A segment of Waymo's perception data set v1: a TFRecord file with one `Frame` message a record."""

from __future__ import annotations

import threading
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.poses import check_pose
from upvl_cli.datasets.waymo.calibration import LaserCalibration, camera_calibration, laser_calibration
from upvl_cli.datasets.waymo.names import RETURNS
from upvl_cli.datasets.waymo.range_images import POSE_CHANNELS, PROJECTION_CHANNELS, RANGE_CHANNELS
from upvl_cli.datasets.waymo.records import Record, read_records
from upvl_cli.datasets.waymo.source import LaserImage, check_shape
from upvl_cli.datasets.waymo.wire import Message, unpack_varints
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

# Field numbers of the message `Frame` (dataset.proto of the Waymo Open Dataset).
CONTEXT, TIMESTAMP, POSE, IMAGES, LASERS = 1, 2, 3, 4, 5
_IMAGE_NAME, _IMAGE_CONTENT, _IMAGE_TIME = 1, 2, 5
_RETURN = {1: 2, 2: 3}  # of `Laser`
_RANGE, _PROJECTION, _PIXEL_POSE = 2, 3, 4  # of `RangeImage`
_MAX_MATRIX_BYTES = 1 << 27  # five times the largest; a damaged stream must not fill the memory
_MIN_LASER_BYTES = 3  # a laser without range images has its name only
_IMAGE_HEAD_BYTES = 4  # holds the name of a camera


class RecordSegment:
    """One segment of v1 (a `SegmentSource`). Opening it reads the places of fields and the first calibration."""

    has_projections = True

    def __init__(self, path: Path) -> None:
        """Open a segment.

        Args:
            path: The TFRecord file.

        Raises:
            BadInput: It is damaged.
        """
        self.where = str(path)
        self.files = (path,)
        self.records: dict[int, Record] = {}
        for record in read_records(path):
            if TIMESTAMP not in record.numbers:
                raise BadInput(
                    f"{record.where} has no time stamp, expected a Waymo frame; copy the file again"
                )
            stamp = record.numbers[TIMESTAMP]
            if stamp in self.records:
                raise BadInput(
                    f"{record.where} has the time stamp {stamp} of record {self.records[stamp].number}; "
                    "expected one record a frame"
                )
            self.records[stamp] = record
        if not self.records:
            raise BadInput(f"{path} holds no record; copy it again")
        numbers = np.array([_pose(record) for record in self.records.values()])
        poses = check_pose(numbers.reshape(-1, 4, 4), f"{path}: the pose of record")
        self.poses: dict[int, Array] = dict(zip(self.records, poses, strict=True))
        self.sweeps = frozenset(
            stamp
            for stamp, record in self.records.items()
            if any(length >= _MIN_LASER_BYTES for _, length in record.fields.get(LASERS, ()))
        )
        first = self.records[min(self.records)]
        context = Message(b"".join(first.read(CONTEXT)[-1:]), f"{first.where}, context")
        self.cameras = _cameras(context)
        self.lasers = _lasers(context)
        self.skipped: Mapping[str, int] = Counter()
        self._parsed: tuple[int, dict[int, Message]] | None = None
        self._lock = threading.Lock()

    def _laser_messages(self, timestamp_us: int) -> dict[int, Message]:
        """Return the lasers of a frame by number; those of one frame are kept."""
        with self._lock:
            if self._parsed is not None and self._parsed[0] == timestamp_us:
                return self._parsed[1]
        record = self.records[timestamp_us]
        messages = [Message(content, f"{record.where}, laser") for content in record.read(LASERS)]
        found = {message.number(1): message for message in messages}
        with self._lock:
            self._parsed = (timestamp_us, found)
        return found

    def _compressed(self, timestamp_us: int, laser: int, return_number: int, field: int) -> memoryview:
        message = self._laser_messages(timestamp_us).get(laser)
        return memoryview(b"") if message is None else message.message(_RETURN[return_number]).block(field)

    def range_images(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 4) of each return of a frame."""
        return self._images(timestamp_us, _RANGE, RANGE_CHANNELS)

    def projections(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 6) of each return of a frame."""
        return self._images(timestamp_us, _PROJECTION, PROJECTION_CHANNELS)

    def _images(self, timestamp_us: int, field: int, channels: int) -> Iterator[LaserImage]:
        for laser in self._laser_messages(timestamp_us):
            for return_number in RETURNS:
                content = self._compressed(timestamp_us, laser, return_number, field)
                image = self._matrix(content, timestamp_us, channels, is_float=field == _RANGE)
                if image is not None:
                    yield laser, return_number, image

    def pixel_poses(self, timestamp_us: int, laser: int) -> Array | None:
        """Return (height, width, 6), or None where it is missing."""
        content = self._compressed(timestamp_us, laser, 1, _PIXEL_POSE)
        return self._matrix(content, timestamp_us, POSE_CHANNELS, is_float=True)

    def _matrix(self, content: memoryview, stamp: int, channels: int, *, is_float: bool) -> Array | None:
        """Return a compressed `MatrixFloat` or `MatrixInt32`, None for one that is empty."""
        if not len(content):
            return None
        where = f"{self.records[stamp].where}, range image"
        matrix = Message(_inflate(content, where), where)
        data = matrix.block(1)
        shape = check_shape(tuple(matrix.message(2).whole_numbers(1)), channels, where)
        try:
            values = np.frombuffer(data, "<f4") if is_float else unpack_varints(data)
        except ValueError:
            raise matrix.damage("its numbers are not whole") from None
        if len(values) != np.prod(shape):
            raise matrix.damage(f"{len(values)} numbers for the shape {shape}")
        return values.reshape(shape)

    def picture(self, timestamp_us: int, camera: int) -> tuple[bytes, float] | None:
        """Return the JPEG and the time of its pose (s; NaN where unknown), or None where it is missing."""
        record = self.records[timestamp_us]
        for index, head in enumerate(record.heads(IMAGES, _IMAGE_HEAD_BYTES)):
            # The name comes first: the other pictures need not be read.
            if head[:1] == b"\x08" and len(head) > 1 and head[1] != camera:
                continue
            image = Message(record.read_one(IMAGES, index), f"{record.where}, picture")
            if image.number(_IMAGE_NAME) == camera and _IMAGE_CONTENT in image:
                time_s = image.double(_IMAGE_TIME) if _IMAGE_TIME in image else np.nan
                return bytes(image.block(_IMAGE_CONTENT)), time_s
        return None


def _inflate(content: memoryview, where: str) -> bytes:
    stream = zlib.decompressobj()
    try:
        found = stream.decompress(content, _MAX_MATRIX_BYTES)
    except zlib.error:
        raise BadInput(f"{where} is damaged (its compression); copy the file again") from None
    if not stream.eof:
        raise BadInput(f"{where} is cut off, or larger than {_MAX_MATRIX_BYTES} bytes; copy the file again")
    return found


def _pose(record: Record) -> Array:
    content = b"".join(record.read(POSE)[-1:])
    values = Message(content, f"{record.where}, pose").doubles(1)
    if len(values) != 16:
        raise BadInput(
            f"{record.where} has a pose of {len(values)} numbers, expected 16; copy the file again"
        )
    return values


def _cameras(context: Message) -> dict[int, Camera]:
    found = {}
    for message in context.messages(2):
        intrinsic = message.doubles(2)
        if len(intrinsic) != 9:
            raise message.damage(f"an intrinsic has {len(intrinsic)} numbers, expected 9")
        size_px = (message.number(4), message.number(5))
        number = message.number(1)
        found[number] = camera_calibration(
            number, intrinsic, message.transform(3).ravel(), size_px, context.where
        )
    return found


def _lasers(context: Message) -> dict[int, LaserCalibration]:
    found = {}
    for message in context.messages(3):
        number, beams_rad = message.number(1), message.doubles(2)
        edges_rad = (message.double(3), message.double(4))
        found[number] = laser_calibration(
            number,
            message.transform(5).ravel(),
            edges_rad,
            beams_rad if len(beams_rad) else None,
            context.where,
        )
    return found
