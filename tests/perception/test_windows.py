"""The windows of a drive hold each sweep, and each sweep has some seconds around it."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.windows import overlapping_windows


@pytest.mark.parametrize("duration_s", [0.0, 9.9, 10.0, 10.1, 15.0, 15.1, 63.7, 400.0])
@pytest.mark.parametrize("step_s", [0.1, 0.37])
def test_each_sweep_is_served_once_and_has_a_quarter_of_a_window_around_it(
    duration_s: float, step_s: float
) -> None:
    time_s = 7.0 + np.append(np.arange(0, duration_s, step_s), duration_s)
    windows = overlapping_windows(time_s, 10.0)
    assert [step for window in windows for step in window.served] == list(range(len(time_s)))
    assert (len(windows) == 1) == (duration_s <= 10.0)
    for window in windows:
        assert time_s[window.learned[-1]] - time_s[window.learned[0]] <= 10.0 + 1e-9
        for step in window.served:
            before, after = (abs(time_s[window.learned[k]] - time_s[step]) for k in (0, -1))
            assert before >= min(2.5, time_s[step] - 7.0) - step_s
            assert after >= min(2.5, 7.0 + duration_s - time_s[step]) - step_s


def test_no_sweep_has_no_window() -> None:
    assert overlapping_windows(np.zeros(0), 10.0) == []
