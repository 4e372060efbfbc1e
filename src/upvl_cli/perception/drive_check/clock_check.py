"""Are the times of the sweeps those of one clock, in order and without gaps?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.config.base import Config, setting
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.types import Array, Floats

_UNITS = (("microseconds", 1e3), ("milliseconds", 1e6), ("seconds", 1e9))
_NAMED = 3  # places that a finding names
_TWO_CLOCKS_SHARE = 0.6  # of the steps are far from the usual one, where two clocks take turns
_MIN_STEPS = 4


@dataclass(frozen=True)
class ClockCheckConfig(Config):
    """What times of sweeps may do."""

    min_step_s: float = setting("shortest usual time between sweeps that a LiDAR has", "s", gt=0, le=10)
    max_step_s: float = setting("longest usual time between sweeps that a drive has", "s", gt=0, le=10_000)
    gap: float = setting("a step of more than this many usual ones is a gap", gt=1, le=1000)
    max_gap_s: float = setting("longest gap without a warning", "s", gt=0, le=10_000)
    max_gap_share: float = setting("most gaps without a warning, as a share of the steps", ge=0, le=1)
    near_share: float = setting(
        "two sweeps that are nearer in time than this share of the usual step are one twice", gt=0, le=1
    )
    max_jitter: float = setting(
        "largest standard deviation of the steps without a warning, as a share of the usual one", gt=0, le=10
    )
    min_rate_hz: float = setting("fewest sweeps a second without a warning", "Hz", gt=0, le=1000)
    max_rate_hz: float = setting("most sweeps a second without a warning", "Hz", gt=0, le=10_000)


def check_clock(sample: DriveSample, config: ClockCheckConfig) -> Iterator[Finding]:
    """Yield the findings on the times of the sweeps.

    Args:
        sample: Part of the drive, with all its frames.
        config: Settings.
    """
    if len(sample.frames) < 2:
        yield Finding("clock", "cannot tell", "one frame has no rate")
        return
    step_s = np.diff([frame.time_ns for frame in sample.frames]) * 1e-9
    faults = [*_order(sample, step_s), *_unit(step_s, config)]
    if faults:
        yield from faults
        return
    found = list(_steps(sample, step_s, config))
    yield from found
    if not found:
        usual_s = float(np.median(step_s))
        text = f"{len(sample.frames)} sweeps in order, {1 / usual_s:.2f} a second"
        yield Finding("clock", "ok", text)


def _order(sample: DriveSample, step_s: Floats) -> Iterator[Finding]:
    back = np.flatnonzero(step_s <= 0)
    if not len(back):
        return
    same = int((step_s == 0).sum())
    text = f"{len(back)} of {len(step_s)} sweeps are not later than the one before"
    text += f", {same} of them at the same time" if same else ""
    cause = "files named out of order, or times of another file"
    if len(back) == len(step_s) and not same:
        cause = "the drive runs backwards: files are numbered from its end"
    elif same == len(step_s):
        cause = "one time stamp was copied for all sweeps"
    remedy = "write the times at which the sweeps were taken, and number the files in their order"
    yield Finding("clock", "fault", text, _places(sample, back + 1), "", cause, remedy)


def _unit(step_s: Floats, config: ClockCheckConfig) -> Iterator[Finding]:
    usual_s = float(np.median(step_s))
    if usual_s <= 0 or config.min_step_s <= usual_s <= config.max_step_s:
        return
    named = [
        f"times in {unit} were taken for nanoseconds"
        for unit, factor in _UNITS
        if config.min_step_s <= usual_s * factor <= config.max_step_s
    ]
    named += [
        f"times in nanoseconds were taken for {unit}"
        for unit, factor in _UNITS
        if config.min_step_s <= usual_s / factor <= config.max_step_s
    ]
    # A LiDAR turns about ten times a second: of two units that would do the first one is nearer to that.
    cause = named[0] if named else "times in another unit"
    text = f"sweeps are {usual_s:.3g} s apart"
    evidence = f"{len(step_s)} steps, expected {config.min_step_s:g} to {config.max_step_s:g} s"
    yield Finding("clock", "fault", text, "", evidence, cause, "write the times of the sweeps in nanoseconds")


def _steps(sample: DriveSample, step_s: Floats, config: ClockCheckConfig) -> Iterator[Finding]:
    """Yield the findings on steps that are all positive."""
    usual_s = float(np.median(step_s))
    if _is_two_clocks(step_s, config):
        text = f"steps take turns between {step_s.min():.3f} and {step_s.max():.3f} s"
        cause = "the sweeps of two LiDARs or two clocks were put in one row"
        yield Finding(
            "clock", "warning", text, "", f"{len(step_s)} steps", cause, "give the sweeps of one LiDAR"
        )
        return
    near = np.flatnonzero(step_s < config.near_share * usual_s)
    if len(near):
        text = f"{len(near)} sweeps follow the one before after less than {config.near_share * usual_s * 1e3:.0f} ms"
        cause = "a sweep that was stored twice, or cut in two"
        yield Finding(
            "clock", "warning", text, _places(sample, near + 1), "", cause, "leave one of the two out"
        )
    gap = np.flatnonzero(step_s > config.gap * usual_s)
    if len(gap) and (step_s.max() > config.max_gap_s or len(gap) > config.max_gap_share * len(step_s)):
        lost = int(np.rint(step_s[gap] / usual_s - 1).sum())
        text = f"{len(gap)} gaps, the longest of {step_s.max():.2f} s: {lost} sweeps are missing"
        evidence = f"usual step {usual_s:.3f} s"
        cause = "sweeps lost while recording or copying"
        remedy = "copy the missing sweeps, or label the parts as drives of their own"
        yield Finding("clock", "warning", text, _places(sample, gap + 1), evidence, cause, remedy)
    regular = step_s[(step_s >= config.near_share * usual_s) & (step_s <= config.gap * usual_s)]
    jitter = float(regular.std() / usual_s)
    if jitter > config.max_jitter:
        text = f"the time between sweeps varies by {jitter:.0%} (standard deviation)"
        cause = "times of arrival were stored, not those of the sensor"
        yield Finding(
            "clock", "warning", text, "", f"{len(regular)} steps", cause, "write the times of the sensor"
        )
    yield from _rate(usual_s, config)


def _rate(usual_s: float, config: ClockCheckConfig) -> Iterator[Finding]:
    rate_hz = 1 / usual_s
    if config.min_rate_hz <= rate_hz <= config.max_rate_hz:
        return
    text = f"{rate_hz:.1f} sweeps a second: at 10 m/s an object moves {10 * usual_s:.2g} m between two"
    cause, remedy = "key frames only", "give the sweeps between the key frames as well where there are any"
    if rate_hz > config.max_rate_hz:
        cause, remedy = "parts of a turn, or several LiDARs in turn", "give whole turns"
    yield Finding("clock", "warning", text, "", "", cause, remedy)


def _is_two_clocks(step_s: Floats, config: ClockCheckConfig) -> bool:
    """Return whether short and long steps take turns while two together always take the same time."""
    if len(step_s) < _MIN_STEPS:
        return False
    both_s = step_s[1:] + step_s[:-1]
    usual_s = float(np.median(both_s))
    uneven = np.abs(step_s - usual_s / 2) > config.max_jitter * usual_s / 2
    even = np.abs(both_s - usual_s) < config.max_jitter * usual_s / 2
    turns = np.sign(np.diff(step_s))
    return bool(
        uneven.mean() > _TWO_CLOCKS_SHARE
        and even.mean() > _TWO_CLOCKS_SHARE
        and (turns[1:] == -turns[:-1]).mean() > _TWO_CLOCKS_SHARE
    )


def _places(sample: DriveSample, steps: Array) -> str:
    named = ", ".join(str(sample.frames[int(step)].index) for step in steps[:_NAMED])
    return f"frame {named}" + (f" and {len(steps) - _NAMED} more" if len(steps) > _NAMED else "")
