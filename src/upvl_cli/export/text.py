"""Text files that people and tools write: read whole, each fault named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput, one_line

_MAX_BYTES = 2**30


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        BadInput: It is missing, is no text in UTF-8, or is larger than a gigabyte.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise BadInput(f"{path} is larger than {_MAX_BYTES >> 20} MiB; expected labels")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or one_line(error)}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path} is no text in UTF-8; expected a file of labels") from None


def read_json(path: Path) -> Any:
    """Return what a JSON file holds; raises `BadInput` as `read_text`, and where it is no JSON."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is no JSON ({one_line(error)}); expected a file of labels") from None


def floats_of(words: list[str], path: Path, line: int) -> list[float]:
    """Return the words of a line as numbers; raises `BadInput` where one is none."""
    try:
        return [float(word) for word in words]
    except ValueError:
        raise BadInput(f"{path}, line {line}: {' '.join(words)[:60]!r} holds no numbers only") from None
