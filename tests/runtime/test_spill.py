"""Arrays come back from disk as they were, and leave no file."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np

from upvl_cli.runtime.spill import ArraySpill


def test_arrays_come_back_in_order_and_leave_no_file(tmp_path: Path) -> None:
    arrays = [np.arange(6, dtype=np.int8).reshape(2, 3), np.zeros((0, 64), np.int8), np.array(1.5)]
    with ArraySpill(tmp_path / "new") as spill:
        for array in arrays:
            spill.append(array)
        assert len(spill) == 3
        for found, expected in zip(spill, arrays, strict=True):
            np.testing.assert_array_equal(found, expected)
            assert found.dtype == expected.dtype
    assert list((tmp_path / "new").iterdir()) == []


def test_memory_is_that_of_one(tmp_path: Path) -> None:
    with ArraySpill(tmp_path) as spill:
        tracemalloc.start()
        for number in range(40):
            spill.append(np.full(10**5, number % 128, np.int8))
        assert [int(array[0]) for array in spill] == list(range(40))
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 10**6
