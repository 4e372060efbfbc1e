"""The content of a file, whole or refused in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput, one_line

_MAX_TEXT_BYTES = 2**30  # the largest table of nuScenes (sample_data.json of the whole set) has 0.6 GiB


def unreadable(path: Path, error: OSError) -> BadInput:
    """Return the error for a file or folder that the system does not let us read."""
    return BadInput(f"{path} cannot be read ({error.strerror}); check that it is there and readable")


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; raises `BadInput` where it is missing or may not be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None


def read_text(path: Path) -> str:
    """Return the content of a text file without its byte-order mark.

    Raises:
        BadInput: It cannot be read, is no UTF-8 text (or UTF-16 with a byte-order mark), or is huge.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise unreadable(path, error) from None
    if size > _MAX_TEXT_BYTES:
        raise BadInput(
            f"{path} has {size} bytes, expected a text of at most {_MAX_TEXT_BYTES}; copy it again"
        )
    content = read_bytes(path)
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not text; copy it from the data set again") from None
    if "\0" in text:
        raise BadInput(f"{path} is not text: it holds zero bytes; copy it from the data set again")
    return text


def read_json(path: Path) -> Any:
    """Return what a JSON file holds; raises `BadInput` where it is no JSON."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is no whole JSON ({one_line(error)}); copy it again") from None
