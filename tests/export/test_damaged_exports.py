"""Damaged exports: what a reader makes of one is boxes or one clear line, never another failure."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from upvl_cli.errors import UpvlError
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import FORMATS, export_format
from upvl_cli.export.run import export, read_back

WITH_BOXES = [name for name in FORMATS if export_format(name).read is not None]
_FOREIGN = (b"", b"null", b"[]", b"{}", b"[[]]", b'{"a": 1}', b"\x00\xff\xfe", b"a,b\n1,2\n", b"\x80" * 64)
_STRANGE: tuple[Any, ...] = (None, -1, 1e300, "../../x", [], {}, True, [None], "NaN", 2**70)


def damages(content: bytes, rng: np.random.Generator, random: int) -> Iterator[bytes]:
    """Cut, flipped and foreign contents of a file."""
    yield from _FOREIGN
    for share in (0.1, 0.5, 0.9):
        yield content[: int(len(content) * share)]
    for _ in range(random if content else 0):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 1 + len(content) // 2000):
            changed[place] = rng.integers(0, 256)
        yield bytes(changed)


def strange(value: Any, rng: np.random.Generator) -> Any:
    """The same JSON with one value, at any depth, of another kind."""
    if rng.random() < 0.25 or not isinstance(value, (dict, list)) or not value:
        return _STRANGE[rng.integers(len(_STRANGE))]
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = keys[rng.integers(len(keys))]
    changed: Any = value.copy()
    if isinstance(changed, dict) and rng.random() < 0.3:
        del changed[key]
    else:
        changed[key] = strange(changed[key], rng)
    return changed


@pytest.mark.parametrize("name", WITH_BOXES)
def test_a_damaged_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    fmt, drive = export_format(name), labelled_drive(frames=2)
    folder = tmp_path / "out"
    export([drive], fmt, folder, ExportOptions(), Counter())
    rng = np.random.default_rng(7)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    for path in files:
        content = path.read_bytes()
        found = list(damages(content, rng, random=6))
        if path.suffix == ".json":
            tree = json.loads(content)
            found += [json.dumps(strange(tree, rng)).encode() for _ in range(12)]
        for damaged in found:
            path.write_bytes(damaged)
            try:
                read_back(fmt, folder, {drive.name: drive})
            except UpvlError as error:
                assert "\n" not in str(error) and len(str(error)) < 600, error
            except Exception as error:  # noqa: BLE001
                kept = tmp_path / f"damaged{path.suffix}"
                kept.write_bytes(damaged)
                pytest.fail(f"{path.relative_to(folder)} raises {error!r}: {damaged[:200]!r}")
        path.write_bytes(content)
    assert read_back(fmt, folder, {drive.name: drive})


@pytest.mark.parametrize("name", WITH_BOXES)
def test_a_missing_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    fmt, drive = export_format(name), labelled_drive(frames=2)
    folder = tmp_path / "out"
    export([drive], fmt, folder, ExportOptions(), Counter())
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = path.read_bytes()
        path.unlink()
        try:
            read_back(fmt, folder, {drive.name: drive})
        except UpvlError as error:
            assert "\n" not in str(error)
        path.write_bytes(content)
