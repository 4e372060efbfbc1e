"""What made a shard, as JSON: equal where the same code made it from the same content with the same values."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

# What a digest of files stands for.
_CONTENTS = {
    "raw.content": "the drive's files have changed",
    "files.content": "the files that the settings name have changed",
}


def to_json(stamp: Mapping[str, Any]) -> str:
    """Return the stamp as JSON, the same text for equal values."""
    return json.dumps(stamp, sort_keys=True, allow_nan=False)


def difference(old: str, new: str) -> str:
    """Return in words which values differ between two stamps; remade inputs are named only where no value differs."""
    before, after = flatten(old), flatten(new)
    names = [name for name in sorted(before | after) if before.get(name) != after.get(name)]
    values = [name for name in names if name not in _CONTENTS and not name.startswith("inputs.")]
    changes = [f"{name} {before.get(name, 'none')} -> {after.get(name, 'none')}" for name in values]
    changes += [change for name, change in _CONTENTS.items() if name in names]
    return ", ".join(changes or [f"{name.removeprefix('inputs.')} was made anew" for name in names])


def is_of_settings(changes: str) -> bool:
    """Whether a `difference` is in values of settings alone, so that the old ones would make both equal again."""
    return " -> " in changes and not any(name in changes for name in (".version ", ".content "))


def flatten(stamp: str) -> dict[str, Any]:
    """Return the values of a stamp by `stage.name`, versions and digests too; none for a text that is no stamp."""
    flat: dict[str, Any] = {}
    try:
        for stage, maker in json.loads(stamp).items():
            values = maker.get("values", {}) | {key: value for key, value in maker.items() if key != "values"}
            flat |= dict(_leaves(values, stage))
    except (ValueError, AttributeError, TypeError, RecursionError):
        return {}
    return flat


def _leaves(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, Any]]:
    """Yield each value of nested tables with its full name."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{above}.{name}")
        else:
            yield f"{above}.{name}", value
