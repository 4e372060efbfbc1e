"""One picture, JPEG or PNG, whole or refused."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from upvl_cli.errors import BadInput
from upvl_cli.types import Array

SUFFIXES = (".png", ".jpg", ".jpeg")  # in any case


def picture_size(source: Path | bytes, where: object) -> tuple[int, int]:
    """Return width and height in pixels, from the header of a picture alone.

    Args:
        source: The file, or its content.
        where: The file, or the table and row of the content, for the message.

    Raises:
        BadInput: It cannot be read, or is neither JPEG nor PNG.
    """
    with _open(source, where) as picture:
        width_px, height_px = picture.size
    return int(width_px), int(height_px)


def check_picture_size(source: Path | bytes, width_px: int, height_px: int, where: object) -> None:
    """Raise `BadInput` where a picture has another size than its calibration says; reads its header alone."""
    _check_size(picture_size(source, where), width_px, height_px, where)


def read_picture(source: Path | bytes, width_px: int, height_px: int, where: object) -> Array:
    """Return the (height, width, 3) uint8 of a picture.

    Args:
        source: The file, or its content.
        width_px: Width by the calibration.
        height_px: Height by the calibration.
        where: The file, or the table and row of the content, for the message.

    Raises:
        BadInput: It is damaged, neither JPEG nor PNG, or of another size.
    """
    with _open(source, where) as picture:
        _check_size(picture.size, width_px, height_px, where)
        return np.array(picture.convert("RGB"))


def _check_size(found_px: tuple[int, int], width_px: int, height_px: int, where: object) -> None:
    if tuple(found_px) != (width_px, height_px):
        raise BadInput(
            f"{where} is {found_px[0]} x {found_px[1]} pixels, but its calibration says "
            f"{width_px} x {height_px}; use pictures and calibration of one size"
        )


@contextmanager
def _open(source: Path | bytes, where: object) -> Iterator[Image.Image]:
    """Open a picture while it is read; what is wrong with it is raised as `BadInput`, and said but once."""
    file = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(file, formats=("PNG", "JPEG")) as picture,
        ):
            yield picture
    except BadInput:
        raise
    except (OSError, SyntaxError, ValueError, OverflowError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "not a whole JPEG or PNG"
        raise BadInput(
            f"{where} cannot be read ({reason}); copy it again, or remove it to do without this picture"
        ) from None
