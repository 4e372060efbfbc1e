"""Voxels: every point in one, means and counts that add up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from upvl_cli.perception.voxels import number_in_order, row_keys, voxelize


def test_two_voxels_by_hand() -> None:
    voxels = voxelize(np.array([[0.1, 0.1, 0.1], [5.0, 0.0, 0.0], [0.3, 0.1, 0.1]]), voxel_m=1.0)
    assert voxels.of_point.tolist() == [0, 1, 0]
    assert voxels.weight.tolist() == [2, 1]
    np.testing.assert_allclose(voxels.centroid, [[0.2, 0.1, 0.1], [5.0, 0.0, 0.0]])


def test_nothing_gives_nothing() -> None:
    voxels = voxelize(np.zeros((0, 3)), voxel_m=0.2)
    assert voxels.of_point.shape == (0,)
    assert voxels.centroid.shape == (0, 3)
    assert voxels.weight.shape == (0,)


@pytest.mark.parametrize("span", [10, 2**40], ids=["fits in 62 bits", "must be numbered anew"])
def test_keys_tell_rows_apart_and_keep_their_order(span: int) -> None:
    rows = np.random.default_rng(0).integers(-span, span, (500, 4))
    rows[100:200] = rows[:100]
    _, expected = np.unique(rows, axis=0, return_inverse=True)
    _, found = np.unique(row_keys(rows), return_inverse=True)
    np.testing.assert_array_equal(found, expected)


@given(arrays(np.int64, st.integers(0, 30), elements=st.integers(-5, 5)))
def test_numbers_count_up_as_met(keys: np.ndarray) -> None:
    numbers = number_in_order(keys)
    seen: dict[int, int] = {}
    assert numbers.tolist() == [seen.setdefault(key, len(seen)) for key in keys.tolist()]
