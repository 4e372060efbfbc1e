"""Numbers behind Waymo's points: packed integers, sines and cosines, polygons."""

from __future__ import annotations

import numpy as np
import pytest

from tiny_waymo import varint
from upvl_cli.datasets.waymo.labels import _in_polygon
from upvl_cli.datasets.waymo.range_images import _sin_cos
from upvl_cli.datasets.waymo.wire import unpack_varints


def test_packed_numbers_of_any_length() -> None:
    numbers = [0, 1, 127, 128, 300, 1919, 16383, 16384, 2**21 - 1, 5]
    content = b"".join(varint(number) for number in numbers)
    assert unpack_varints(content).tolist() == numbers
    assert unpack_varints(b"").tolist() == []
    for damaged in (content + b"\x80", b"\x80", varint(2**21)):
        with pytest.raises(ValueError, match="number"):
            unpack_varints(damaged)


@pytest.mark.parametrize("spread_rad", [0.0, 0.001, 0.09, 0.5, 7.0])
def test_sines_and_cosines(spread_rad: float) -> None:
    angle_rad = 0.76 + np.linspace(-spread_rad, spread_rad, 101)
    sine, cosine = _sin_cos(angle_rad)
    np.testing.assert_allclose(sine, np.sin(angle_rad), atol=1e-15, rtol=0)
    np.testing.assert_allclose(cosine, np.cos(angle_rad), atol=1e-15, rtol=0)


def test_places_in_a_polygon_that_is_not_convex() -> None:
    corners = np.array([[0, 0], [40, 0], [40, 10], [10, 10], [10, 40], [0, 40]], float)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-9.5, 50, 2), np.arange(-9.5, 50, 2)))
    inside = (x > 0) & (y > 0) & (((x < 40) & (y < 10)) | ((x < 10) & (y < 40)))
    np.testing.assert_array_equal(_in_polygon(np.stack([x, y], axis=1), corners), inside)
    assert not _in_polygon(np.zeros((3, 2)), np.zeros((0, 2))).any()
