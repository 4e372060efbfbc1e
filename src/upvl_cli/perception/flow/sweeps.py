"""Which sweeps a sweep is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from upvl_cli.types import Floats


class OtherSweep(NamedTuple):
    """Points above the ground of another sweep.

    Attributes:
        xyz_m: (m, 3) points in the axes of the sweep that is compared with it.
        dt_s: Time from that sweep to this one; negative where this one came before.
    """

    xyz_m: Floats
    dt_s: float


def other_steps(
    times_s: Sequence[float], step: int, min_interval_s: float, confirm_interval_s: float
) -> tuple[int, ...]:
    """Return the sweeps that one is compared with: first the target of its flow, then the one that confirms it.

    The target is the first one at least an interval later; where the drive ends before, the last one at least the
    interval earlier; in a drive that is shorter, its far end. One that is at least the other interval away confirms,
    on the other side of the sweep, or at the end of a drive on the same.

    Args:
        times_s: (n,) times of the sweeps, ascending.
        step: The sweep.
        min_interval_s: Shortest time to the target.
        confirm_interval_s: Shortest time to the sweep that confirms.

    Returns:
        None, one or two steps.
    """
    later = _later(times_s, step, min_interval_s)
    earlier = _earlier(times_s, step, min_interval_s)
    if later is None and earlier is None:
        ends = sorted({0, len(times_s) - 1} - {step}, key=lambda end: -abs(times_s[end] - times_s[step]))
        return tuple(ends[:1])
    away, back = (_earlier, _later) if later is None else (_later, _earlier)
    target = earlier if later is None else later
    assert target is not None
    confirming = back(times_s, step, confirm_interval_s)
    if confirming is None:
        confirming = away(times_s, target, confirm_interval_s - abs(times_s[target] - times_s[step]))
    return (target,) if confirming is None else (target, confirming)


def _later(times_s: Sequence[float], step: int, min_interval_s: float) -> int | None:
    """Return the first sweep at least the interval after one; None where there is none."""
    steps = range(step + 1, len(times_s))
    return next((other for other in steps if times_s[other] - times_s[step] >= min_interval_s), None)


def _earlier(times_s: Sequence[float], step: int, min_interval_s: float) -> int | None:
    """Return the last sweep at least the interval before one; None where there is none."""
    steps = range(step - 1, -1, -1)
    return next((other for other in steps if times_s[step] - times_s[other] >= min_interval_s), None)
