"""The tables `cameras/<segment>.parquet` and `images/<segment>.parquet`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from upvl_cli.datasets.shared.arrow import (
    arrow_errors,
    check_columns,
    integers,
    list_cell,
    matrices,
    open_parquet,
    read_parquet,
    texts,
    values,
)
from upvl_cli.datasets.shared.parquet_columns import BytesColumn
from upvl_cli.datasets.shared.paths import inside
from upvl_cli.datasets.shared.pictures import check_picture_size, read_picture
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Image

_INTRINSIC = ("fx_px", "fy_px", "cx_px", "cy_px")
_SIZE = ("width_px", "height_px")
_COEFFICIENTS = {"none": 0, "brown": 5, "fisheye": 4}
_MAX_SIZE_PX = 65535
_MAX_FOCAL_PX = 1e6
_MAX_COEFFICIENT = 1e4


def read_cameras(path: Path) -> tuple[Camera, ...]:
    """Return the calibrated cameras of a drive.

    Raises:
        BadInput: The file is no such table, or a calibration is impossible.
    """
    columns = ("camera", *_SIZE, *_INTRINSIC, "distortion_model", "distortion", "ego_from_camera")
    table = read_parquet(path, columns)
    names = texts(table, "camera", path)
    if len(set(names)) < len(names):
        raise BadInput(f"{path} has two rows of one camera: {', '.join(names)[:200]}; keep one a camera")
    sizes = np.column_stack([integers(table, name, path) for name in _SIZE])
    intrinsics = np.column_stack([values(table, name, "float64", path) for name in _INTRINSIC])
    mounts = matrices(table, "ego_from_camera", 16, path)
    if mounts is None:
        raise BadInput(f"{path}: ego_from_camera is empty, expected the pose of each camera on the car")
    models = texts(table, "distortion_model", path)
    cameras = []
    for row, name in enumerate(names):
        where = f"{path}, row {row} ({name[:40]})"
        cell = table["distortion"][row]
        given = (
            list_cell(table["distortion"], row, "float64", f"{path}, column distortion")
            if cell.is_valid
            else ()
        )
        model, distortion = _distortion(models[row], np.asarray(given, dtype=np.float64), where)
        cameras.append(
            Camera(
                name=name,
                width_px=_size(sizes[row], where)[0],
                height_px=_size(sizes[row], where)[1],
                intrinsic=_intrinsic(intrinsics[row], where),
                distortion=distortion,
                ego_from_camera=check_pose(
                    mounts[row].reshape(4, 4), f"{where}: ego_from_camera", max_m=MAX_ON_CAR_M
                ),
                distortion_model=model,
            )
        )
    return tuple(cameras)


def _size(size_px: Array, where: str) -> tuple[int, int]:
    if not ((size_px >= 1) & (size_px <= _MAX_SIZE_PX)).all():
        raise BadInput(
            f"{where} has pictures of {size_px[0]} x {size_px[1]} pixels, which is no size of a picture"
        )
    return int(size_px[0]), int(size_px[1])


def _intrinsic(numbers: Array, where: str) -> Array:
    fx, fy, cx, cy = numbers
    if not (min(fx, fy) >= 1 and np.abs(numbers).max() <= _MAX_FOCAL_PX):
        raise BadInput(
            f"{where} has fx, fy, cx, cy = {numbers.tolist()}, expected a focal length of 1 to {_MAX_FOCAL_PX:g} pixels"
        )
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _distortion(model: str, given: Array, where: str) -> tuple[Literal["brown", "fisheye"], Array]:
    """Return the lens model of `Camera` and its coefficients."""
    if model not in _COEFFICIENTS:
        raise BadInput(
            f"{where}: distortion_model is {model[:40]!r}, expected one of {', '.join(_COEFFICIENTS)}"
        )
    count = _COEFFICIENTS[model]
    if len(given) != count and count:
        raise BadInput(f"{where}: distortion has {len(given)} numbers, expected {count} of the model {model}")
    if not np.abs(given).max(initial=0.0) <= _MAX_COEFFICIENT:
        raise BadInput(f"{where}: distortion is {given.tolist()}, expected finite coefficients")
    return ("fisheye", given) if model == "fisheye" else ("brown", given if count else np.zeros(5))


@dataclass(frozen=True, eq=False)
class PictureTable:
    """The pictures of a drive.

    Attributes:
        root: The folder below which pictures lie.
        path: The file of the table.
        row: Row of each picture, by frame and camera.
        time_ns: (n,) when each row's picture was taken.
        paths: Path of each row's picture as the table has it; None where its bytes are in the table.
    """

    root: Path
    path: Path
    row: Mapping[tuple[int, str], int]
    time_ns: Array
    paths: list[str | None]
    _content: BytesColumn | None

    def read(self, frame: int, camera: Camera) -> Image | None:
        """Return the picture of a camera in a frame, or None where there is none.

        Raises:
            BadInput: It is damaged, or of another size than the calibration says.
        """
        row = self.row.get((frame, camera.name))
        if row is None:
            return None
        source, where = self._source(row)
        return Image(read_picture(source, camera.width_px, camera.height_px, where), int(self.time_ns[row]))

    def check_size(self, camera: Camera) -> None:
        """Raise `BadInput` where the first picture of a camera is of another size than its calibration says."""
        row = min((row for (_, name), row in self.row.items() if name == camera.name), default=None)
        if row is not None:
            source, where = self._source(row)
            check_picture_size(source, camera.width_px, camera.height_px, where)

    @property
    def files(self) -> list[Path]:
        """The files of the pictures that are read."""
        return sorted(
            {self.root / text for row in self.row.values() if (text := self.paths[row]) is not None}
        )

    def _source(self, row: int) -> tuple[Path | bytes, str]:
        text, where = self.paths[row], f"{self.path}, row {row}"
        if text is not None:
            path = inside(self.root, text, where)
            return path, str(path)
        if self._content is None:
            raise BadInput(f"{where} has neither path nor data, expected one of them")
        content = self._content.row(row)
        if not content:
            raise BadInput(f"{where} has neither path nor data, expected the bytes of a JPEG or PNG in data")
        return content, where


def open_pictures(
    root: Path, path: Path, frames: Collection[int], cameras: Collection[str], skipped: Counter[str]
) -> PictureTable:
    """Return the pictures of a drive; their bytes are not read yet.

    Args:
        root: The folder below which pictures lie.
        path: The table.
        frames: Frames of the drive; pictures of others are counted.
        cameras: Names of the calibrated cameras; pictures of others are counted.
        skipped: Count of what is left out, by reason.

    Raises:
        BadInput: The file is no such table, or a path leaves the folder.
    """
    names = open_parquet(path).schema_arrow.names
    check_columns(names, ("frame", "camera", "time_ns"), path)
    if "path" not in names and "data" not in names:
        raise BadInput(
            f"{path} has neither the column path nor data, expected one; it has {', '.join(names)[:300]}"
        )
    table = read_parquet(path, ("frame", "camera", "time_ns"), ("path",))
    numbers, time_ns = (integers(table, name, path) for name in ("frame", "time_ns"))
    owners = texts(table, "camera", path)
    paths: list[str | None] = [None] * len(owners)
    if "path" in names:
        with arrow_errors(path):
            paths = [text if isinstance(text, str) else None for text in table["path"].to_pylist()]
    known, row_of = set(frames), {}
    for row, (frame, camera) in enumerate(zip(numbers.tolist(), owners, strict=True)):
        if camera not in cameras:
            skipped[f"{camera[:40]} picture without calibration"] += 1
        elif frame not in known:
            skipped["picture of a frame without a sweep"] += 1
        elif (frame, camera) in row_of:
            raise BadInput(f"{path}, row {row} is a second picture of {camera} in frame {frame}; keep one")
        else:
            row_of[frame, camera] = row
            if (text := paths[row]) is not None:
                inside(root, text, f"{path}, row {row}")
    content = BytesColumn(path, "data") if "data" in names else None
    return PictureTable(root, path, row_of, time_ns, paths, content)
