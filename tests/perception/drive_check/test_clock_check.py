"""The check of the times of sweeps."""

from __future__ import annotations

import numpy as np
import pytest

from ray_street import CONFIG, STEP_NS, drive_sample, with_times
from upvl_cli.perception.drive_check.clock_check import check_clock
from upvl_cli.perception.drive_check.finding import Finding

TIMES = np.arange(40) * STEP_NS


def findings(time_ns: np.ndarray) -> list[Finding]:
    return list(check_clock(with_times(drive_sample(), list(time_ns)), CONFIG.clock))


def test_right_times_are_ok() -> None:
    (found,) = findings(TIMES)
    assert found.level == "ok" and found.text == "40 sweeps in order, 10.00 a second"
    for step in (0.2, 0.05):  # 5 Hz and 20 Hz
        assert findings(np.arange(40) * step * 1e9)[0].level == "ok"
    jittered = TIMES + np.random.default_rng(0).normal(0, 4e6, 40)
    assert [found.level for found in findings(jittered)] == ["ok"]


def test_a_single_frame_cannot_tell() -> None:
    assert findings(TIMES[:1])[0].level == "cannot tell"


@pytest.mark.parametrize(
    ("time_ns", "level", "text", "cause", "where"),
    [
        (TIMES[::-1], "fault", "39 of 39", "runs backwards", "frame 1, 2, 3 and 36 more"),
        (np.full(40, 7), "fault", "39 of 39", "one time stamp was copied", "frame 1, 2, 3 and 36 more"),
        (np.delete(TIMES, 10)[[*range(5), 6, 5, *range(7, 39)]], "fault", "1 of 38", "out of order", "frame 6"),
        (TIMES / 1e9 * 1e6, "fault", "0.0001 s apart", "microseconds were taken for nanoseconds", ""),
        (TIMES / 1e9 * 1e3, "fault", "1e-07 s apart", "milliseconds were taken for nanoseconds", ""),
        (TIMES * 1e6, "fault", "1e+05 s apart", "nanoseconds were taken for milliseconds", ""),
        (np.delete(TIMES, range(10, 24)), "warning", "1 gaps, the longest of 1.50 s: 14 sweeps", "lost", "frame 10"),
        (np.delete(TIMES, [5, 15, 25]), "warning", "3 gaps, the longest of 0.20 s", "lost", "frame 5, 14, 23"),
        (np.sort([*TIMES, TIMES[9] + 10**6]), "warning", "1 sweeps follow", "stored twice", "frame 10"),
        (np.arange(40) * 5 * STEP_NS, "warning", "2.0 sweeps a second: at 10 m/s an object moves 5", "key frames", ""),
        (np.arange(40) * STEP_NS // 5, "warning", "50.0 sweeps a second", "parts of a turn", ""),
        (
            np.sort([*TIMES, *(TIMES + 30_000_000)]),
            "warning",
            "take turns between 0.030 and 0.070 s",
            "two LiDARs or two clocks",
            "",
        ),
    ],
)  # fmt: skip
def test_each_fault_is_named(time_ns: np.ndarray, level: str, text: str, cause: str, where: str) -> None:
    (found,) = findings(time_ns)
    assert found.level == level and text in found.text and cause in found.cause
    assert found.where == where


def test_a_single_lost_sweep_of_a_long_drive_is_no_warning() -> None:
    assert [found.level for found in findings(np.delete(np.arange(200) * STEP_NS, 50))] == ["ok"]


def test_times_of_arrival_are_seen_by_their_jitter() -> None:
    jittered = np.sort(TIMES + np.random.default_rng(0).normal(0, 20e6, 40))
    assert "times of arrival" in findings(jittered)[0].cause
