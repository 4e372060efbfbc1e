"""The JSON file that says what a graph of the user's expects: each key checked, all mistakes named at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput
from upvl_cli.vlm.checkpoint import read_json

# Each key: what its value has to be, and whether a value is that.
CardKeys = Mapping[str, tuple[str, Callable[[Any], bool]]]


def is_number(value: Any) -> bool:
    """Return whether a value of JSON is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def is_integer(value: Any) -> bool:
    """Return whether a value of JSON is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_triple(value: Any) -> bool:
    """Return whether a value of JSON is a list of three finite numbers."""
    return isinstance(value, list) and len(value) == 3 and all(map(is_number, value))


def is_strings(value: Any) -> bool:
    """Return whether a value of JSON is a list of strings."""
    return isinstance(value, list) and all(isinstance(word, str) for word in value)


# What an image network expects.
IMAGE_KEYS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "mean": ("3 numbers, of pixels from 0 to 1", is_triple),
    "std": ("3 positive numbers", lambda value: is_triple(value) and min(value) > 0),
    "multiple": ("a whole number from 1 on", lambda value: is_integer(value) and value > 0),
}


def read_card(path: Path, keys: CardKeys) -> dict[str, Any]:
    """Return the values of a JSON file.

    Raises:
        BadInput: A key is unknown, missing or of another kind; all of them are named.
    """
    content = read_json(path)
    problems = [f"unknown key {key!r}" for key in content if key not in keys]
    problems += [f"{key!r} is missing" for key in keys if key not in content]
    problems += [
        f"{key!r} is {content[key]!r}, expected {expected}"
        for key, (expected, fits) in keys.items()
        if key in content and not fits(content[key])
    ]
    if problems:
        raise BadInput(f"{path}: {'; '.join(problems)} (known keys: {', '.join(keys)})")
    return content
