"""Files of a folder that are named by the number of their frame."""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from pathlib import Path

from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.folders import entries
from upvl_cli.errors import BadInput

_NUMBER = re.compile(r"[0-9]{1,19}")
_MAX_NUMBER = 2**62  # a time in nanoseconds since 1970 has 19 digits; twice as much still fits 64 bits
_SHOWN = 3


def numbered_files(folder: Path, suffixes: Collection[str]) -> dict[int, Path]:
    """Return the files of a folder by frame number, in ascending order; empty where there is no such folder.

    Args:
        folder: The folder.
        suffixes: Suffixes of the files in lower case, for example `.bin`; files have them in any case.

    Raises:
        BadInput: The folder may not be listed, or two files have one number.
    """
    try:
        names = [name for name, _ in entries(folder)]
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise unreadable(folder, error) from None
    files: dict[int, Path] = {}
    for name in names:
        stem, suffix = os.path.splitext(name)
        if suffix.lower() in suffixes and _NUMBER.fullmatch(stem) and int(stem) <= _MAX_NUMBER:
            number = int(stem)
            if number in files:
                raise BadInput(
                    f"{folder} has two files of frame {number}: {files[number].name} and {name}; remove one"
                )
            files[number] = folder / name
    return dict(sorted(files.items()))


def has_files(folder: Path) -> bool:
    """Return whether anything lies in a folder, hidden files apart; false where there is no such folder."""
    try:
        return any(not name.startswith(".") for name, _ in entries(folder))
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise unreadable(folder, error) from None


def describe_files(folder: Path) -> str:
    """Return what lies in a folder, for a message: `8 files like 000060.bin`, `no such folder`."""
    try:
        names = [name for name, _ in entries(folder) if not name.startswith(".")]
    except FileNotFoundError:
        return f"no folder {folder}"
    except OSError as error:
        return f"{folder}: {error.strerror}"
    if not names:
        return f"nothing in {folder}"
    examples: dict[str, str] = {}
    for name in names:
        examples.setdefault(os.path.splitext(name)[1].lower(), name)
    shown = ", ".join(list(examples.values())[:_SHOWN])
    return f"{len(names)} file{'s' if len(names) > 1 else ''} like {shown} in {folder}"
