"""Scales and units are read off the whole drive, and points come out in ego axes."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from upvl_cli.datasets.recordings.conversion import measure, offsets_ns
from upvl_cli.datasets.recordings.recording import LidarScan, RecordedSweep
from upvl_cli.datasets.shared.point_files.scan import ScanPoints

NOW_NS = 1_532_402_927_647_951_000


def scan(intensity=None, time=None, lidar: int = 0) -> LidarScan:  # noqa: ANN001
    total = len(intensity if intensity is not None else time)
    points = ScanPoints(np.ones((total, 3), np.float32), intensity, None, None, time, "test", {})
    return LidarScan(lidar, NOW_NS, points, np.eye(4))


@pytest.mark.parametrize(
    ("brightest", "dtype", "scale"),
    [(0.9, "f4", 1), (1, "f4", 1), (1, "u1", 255), (37, "f4", 255), (255, "u1", 255), (256, "u2", 1023),
     (3000, "f4", 4095), (65535, "u2", 65535), (1e6, "f4", 1e6)],
)  # fmt: skip
def test_the_scale_is_that_of_the_drive(brightest: float, dtype: str, scale: float) -> None:
    """A sweep whose brightest return is weak is scaled as the others are."""
    dark, bright = scan(np.array([0, 1]).astype(dtype)), scan(np.array([0, brightest]).astype(dtype))
    conversion = measure([dark, bright], None, None)
    assert conversion.units[0].intensity_max == pytest.approx(scale)
    row = conversion.row(RecordedSweep(0, 0, NOW_NS, None, (dark,)), Counter())
    np.testing.assert_allclose(row.values["intensity"], [0, 1 / scale], rtol=1e-6)


def test_a_given_scale_counts_and_brighter_is_1() -> None:
    bright = scan(np.array([-1, 50, 200], "f4"))
    row = measure([bright], 100.0, None).row(RecordedSweep(0, 0, NOW_NS, None, (bright,)), Counter())
    np.testing.assert_allclose(row.values["intensity"], [0, 0.5, 1])


@pytest.mark.parametrize(
    ("times", "expected_ns"),
    [
        (np.array([0, 0.05, 0.1]), [0, 5e7, 1e8]),
        (np.array([-0.1, -0.05, 0]), [-1e8, -5e7, 0]),
        (np.array([0, 50, 100], "f4"), [0, 5e7, 1e8]),
        (np.array([0, 50_000, 100_000], "u4"), [0, 5e7, 1e8]),
        (np.array([0, 50_000_000, 100_000_000], "u4"), [0, 5e7, 1e8]),
        (NOW_NS + np.array([0, 50_000_000, 100_000_000]), [0, 5e7, 1e8]),
        ((NOW_NS + np.array([0, 50_000_000, 100_000_000])).astype("u8"), [0, 5e7, 1e8]),
        (NOW_NS // 1000 + np.array([0, 50_000, 100_000]), [0, 5e7, 1e8]),
        (NOW_NS / 1e9 + np.array([0, 0.05, 0.1]), [0, 5e7, 1e8]),
        (777.0 + np.array([0, 0.05, 0.1]), [0, 5e7, 1e8]),  # seconds since the sensor was switched on
    ],
)
def test_units_of_point_times(times: np.ndarray, expected_ns: list[float]) -> None:
    conversion = measure([scan(time=times)], None, None)
    found = offsets_ns(times, conversion.units[0].time_unit_ns, NOW_NS)
    np.testing.assert_allclose(found, expected_ns, atol=2000)


def test_points_of_one_moment_have_no_times() -> None:
    conversion = measure([scan(time=np.zeros(5))], None, None)
    assert not conversion.has_times
    assert conversion.columns == ()


def test_two_lidars_have_units_of_their_own() -> None:
    first, second = scan(np.array([0, 0.5], "f4")), scan(np.array([0, 200], "u1"), lidar=1)
    conversion = measure([first, second], None, None)
    row = conversion.row(RecordedSweep(0, 0, NOW_NS, None, (first, second)), Counter())
    np.testing.assert_allclose(row.values["intensity"], [0, 0.5, 0, 200 / 255], rtol=1e-6)
    assert row.values["sensor"].tolist() == [0, 0, 1, 1]
