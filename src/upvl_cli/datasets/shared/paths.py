"""Names of segments, and paths that data name: none leaves the folder of the data."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.errors import BadInput

SEGMENT_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,199}")
_MAX_NAMES = 10


def inside(root: Path, text: str, where: str) -> Path:
    """Return the path that data name, which is relative to a folder and stays in it.

    Args:
        root: The folder.
        text: The path as the data give it, with `/` between its parts.
        where: File and row that name it, for the message.

    Raises:
        BadInput: It is absolute or leaves the folder, by `..` or by a link.
    """
    clean = bool(text) and "\0" not in text and "\\" not in text and not os.path.isabs(text)
    path = root / text if clean else root
    try:
        if clean and path.resolve().is_relative_to(root.resolve()):
            return path
    except (OSError, RuntimeError):  # a circle of links, or a name that is too long
        pass
    raise BadInput(f"{where} names {text[:80]!r}, expected the relative path of a file below {root}")


def check_segment_name(name: str, where: object) -> str:
    """Return the name of a segment; raises `BadInput` where a file cannot be called so."""
    if not SEGMENT_NAME.fullmatch(name):
        raise BadInput(
            f"{where}: a drive's name holds letters, digits, '.', '_', '-' only, and begins with a letter, a digit "
            f"or '_', found {name[:80]!r}; rename it"
        )
    return name


def unknown_segment(root: Path, name: str, known: Sequence[str]) -> BadInput:
    """Return the error for a segment that a dataset does not have, with the nearest that it has."""
    if len(known) <= _MAX_NAMES:
        hint = f"it has {', '.join(known)}"
    else:
        close = difflib.get_close_matches(name, known)
        nearest = f"the nearest are {', '.join(close)}" if close else f"the first is {known[0]}"
        hint = f"of its {len(known)} segments {nearest}"
    return BadInput(f"{root} has no segment {name!r}; {hint}")


def find(root: Path, patterns: Iterable[str]) -> list[Path]:
    """Return what lies below a folder under any of the patterns, each once, sorted within its pattern.

    Raises:
        BadInput: A folder may not be listed.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        try:
            found.update(dict.fromkeys(sorted(root.glob(pattern))))
        except OSError as error:
            raise unreadable(root, error) from None
    return list(found)
