"""Memory of files that is given back."""

from __future__ import annotations

import mmap
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.query.mapped_file import MappedFile

SMAPS = Path("/proc/self/smaps")
MIB = 2**20

pytestmark = pytest.mark.skipif(
    not SMAPS.exists(), reason="the system does not say which pages are in memory"
)


def resident_bytes(path: Path) -> int:
    """How much of a mapped file the process holds."""
    total, inside = 0, False
    for line in SMAPS.read_text().splitlines():
        if not line.split()[0].endswith(":"):
            inside = line.endswith(str(path))
        elif inside and line.startswith("Rss:"):
            total += 1024 * int(line.split()[1])
    return total


def test_released_memory_is_read_again_when_it_is_used(tmp_path: Path) -> None:
    path = tmp_path / "values"
    expected = np.random.default_rng(0).integers(0, 255, 4 * MIB, np.uint8)
    path.write_bytes(expected.tobytes())
    mapped = MappedFile(path)
    values = np.frombuffer(mapped.buffer, np.uint8)
    assert np.array_equal(values, expected)
    assert resident_bytes(path) >= 4 * MIB
    mapped.release(values[MIB + 1 : 3 * MIB])
    assert resident_bytes(path) <= 2 * MIB + 2 * mmap.PAGESIZE  # less where the system maps huge pages
    mapped.release(values)
    assert resident_bytes(path) == 0
    assert np.array_equal(values, expected)


def test_memory_elsewhere_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "values"
    path.write_bytes(bytes(MIB))
    mapped = MappedFile(path)
    elsewhere = np.arange(MIB)
    mapped.release(elsewhere)
    mapped.release(elsewhere[:0])
    assert np.array_equal(elsewhere, np.arange(MIB))
