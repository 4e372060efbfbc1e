"""Arrays that a user's own program has written, in NumPy's format."""

from __future__ import annotations

import struct
import tokenize
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput, one_line

# What NumPy raises on headers that are damaged.
_HEADER_ERRORS = (
    ValueError, SyntaxError, TypeError, KeyError, IndexError, AttributeError, RecursionError, MemoryError,
    OverflowError, EOFError, tokenize.TokenError, struct.error,
)  # fmt: skip


def frame_files(root: Path, segment: str) -> tuple[Path, ...]:
    """Return the files `ROOT/SEGMENT/FRAME.npy` of a drive, in order; none where there is no such folder."""
    return tuple(sorted((root / segment).glob("*.npy")))


def frame_file(root: Path, segment: str, frame: int) -> Path:
    """Return the path of a frame's file: `ROOT/SEGMENT/000000.npy`, the number with at least six digits."""
    return root / segment / f"{frame:06d}.npy"


def read_array(root: Path, path: Path) -> Any:
    """Return the array in a `.npy` file; nothing is unpickled.

    Args:
        root: Folder that the file must lie in, links followed.
        path: The file.

    Raises:
        BadInput: The file leads out of `root`, is missing, or holds no array.
    """
    import numpy as np

    if not path.resolve().is_relative_to(root.resolve()):
        raise BadInput(f"{path} leads out of {root}; put the file itself there")
    try:
        with path.open("rb") as file:
            return np.lib.format.read_array(file, allow_pickle=False)
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or one_line(error)}") from error
    except _HEADER_ERRORS as error:
        raise BadInput(f"{path} is not a .npy file of numbers: {one_line(error)}") from error
