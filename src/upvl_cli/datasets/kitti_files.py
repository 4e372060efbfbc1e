"""One sweep or one picture of KITTI's, whole or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from upvl_cli.datasets.kitti_text import read_bytes
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Points

_POINT_BYTES = 16  # x, y, z, reflectance as little-endian float32
_NUMBER = "[0-9]" * 10  # a file is named by its frame, in ten digits


def numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """The files of a folder by frame number, in ascending order; empty where there is no such folder."""
    return {int(path.stem): path for path in sorted(folder.glob(_NUMBER + suffix))}


def read_sweep(path: Path) -> Points:
    """The points of a `.bin`; raises `BadInput` where it is missing, empty, cut off or not finite."""
    content = read_bytes(path)
    if not content or len(content) % _POINT_BYTES:
        raise BadInput(
            f"{path} has {len(content)} bytes, expected a multiple of {_POINT_BYTES} above 0 "
            "(float32 x, y, z, reflectance): it is empty or cut off; copy it again, or remove it to skip it"
        )
    values = np.frombuffer(content, dtype="<f4").reshape(-1, 4)
    wrong = len(values) - np.isfinite(values).all(axis=1).sum()
    if wrong:
        raise BadInput(
            f"{path}: {wrong} of {len(values)} points are NaN or infinite, expected finite numbers; "
            "copy it again, or remove it to skip it"
        )
    return Points(
        xyz_ego_m=np.ascontiguousarray(values[:, :3]),
        intensity=np.ascontiguousarray(values[:, 3]),
        elongation=np.zeros(len(values)),
        sensor=np.zeros(len(values)),
        time_offset_ns=np.zeros(len(values)),
    )


def check_picture(path: Path, width_px: int, height_px: int) -> None:
    """Nothing where the header of a PNG has this size; raises `BadInput` otherwise."""
    try:
        with Image.open(path, formats=("PNG",)) as picture:
            found_px = picture.size
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _damaged(path, error) from None
    if found_px != (width_px, height_px):
        raise BadInput(
            f"{path} is {found_px[0]} x {found_px[1]} pixels, but S_rect of calib_cam_to_cam.txt says "
            f"{width_px} x {height_px}; use pictures and calibration of one size"
        )


def read_picture(path: Path, width_px: int, height_px: int) -> Array:
    """The (height, width, 3) uint8 of a PNG; raises `BadInput` where it is damaged or of another size."""
    check_picture(path, width_px, height_px)
    try:
        with Image.open(path, formats=("PNG",)) as picture:
            return np.array(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> BadInput:
    reason = getattr(error, "strerror", None) or "not a whole PNG"
    return BadInput(
        f"{path} cannot be read ({reason}); copy it again, or remove it to do without this picture"
    )
