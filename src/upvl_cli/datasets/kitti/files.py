"""One sweep or one picture of KITTI's, whole or refused."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from upvl_cli.datasets.kitti.text import read_bytes
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

_POINT_BYTES = 16  # x, y, z, reflectance as little-endian float32
_MOST_M = 1e4  # a LiDAR sees a few hundred metres; farther is no place but a damaged number
_NUMBER = "[0-9]" * 10  # a file is named by its frame, in ten digits


def numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """Return the files of a folder by frame number, in ascending order; empty where there is no such folder."""
    return {int(path.stem): path for path in sorted(folder.glob(_NUMBER + suffix))}


def read_sweep(path: Path) -> Array:
    """Return (n, 4) float32 x, y, z and reflectance of a `.bin`.

    Raises:
        BadInput: The file is missing, cut off or no sweep.
    """
    content = read_bytes(path)
    if not content or len(content) % _POINT_BYTES:
        raise BadInput(
            f"{path} has {len(content)} bytes, expected a multiple of {_POINT_BYTES} above 0 "
            "(float32 x, y, z, reflectance): it is empty or cut off; copy it again, or remove it to skip it"
        )
    values = np.frombuffer(content, dtype="<f4").reshape(-1, 4)
    # One pass over what is nearly always in order; NaN fails every comparison.
    if not np.abs(values).max() <= _MOST_M:
        _check_points(path, values)
    return values


def _check_points(path: Path, values: Array) -> None:
    """Raise `BadInput` where points cannot be what a LiDAR saw."""
    wrong = len(values) - np.isfinite(values).all(axis=1).sum()
    if wrong:
        raise BadInput(
            f"{path}: {wrong} of {len(values)} points are NaN or infinite, expected finite numbers; "
            "copy it again, or remove it to skip it"
        )
    far = np.count_nonzero((np.abs(values[:, :3]) > _MOST_M).any(axis=1))
    if far:
        raise BadInput(
            f"{path}: {far} of {len(values)} points are more than {_MOST_M / 1000:g} km away, which no LiDAR "
            "sees; copy it again, or remove it to skip it"
        )


def check_picture(path: Path, width_px: int, height_px: int) -> None:
    """Nothing where the header of a PNG has this size; raises `BadInput` otherwise."""
    with _opened(path) as picture:
        found_px = picture.size
    if found_px != (width_px, height_px):
        raise BadInput(
            f"{path} is {found_px[0]} x {found_px[1]} pixels, but S_rect of calib_cam_to_cam.txt says "
            f"{width_px} x {height_px}; use pictures and calibration of one size"
        )


def read_picture(path: Path, width_px: int, height_px: int) -> Array:
    """Return the (height, width, 3) uint8 of a PNG; raises `BadInput` where it is damaged or of another size."""
    check_picture(path, width_px, height_px)
    with _opened(path) as picture:
        return np.array(picture.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open a PNG while it is read; what is wrong with it is raised as `BadInput`, and said but once."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=("PNG",)) as picture:
            yield picture
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "not a whole PNG"
        raise BadInput(
            f"{path} cannot be read ({reason}); copy it again, or remove it to do without this picture"
        ) from None
