"""What could be wrong with the poses of a drive, each as the motions between sweeps that would follow from it.

Only motions between sweeps can be compared with sweeps, so what turns or shifts the world as a whole is no fault here:
labels are the same in any world.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import compose, from_yaw, inverse, wrap_angle, yaw_of
from upvl_cli.perception.drive_check.finding import correction
from upvl_cli.perception.drive_check.pose_arithmetic import ESTIMATED
from upvl_cli.types import Array, Floats, Ints

_NAMES = ("x", "y", "z")
# The axes that poses come in most often, in this order: camera (z forward), aerospace, right-forward-up, backwards.
_FREQUENT_AXES = (("z", "-x", "-y"), ("x", "-y", "-z"), ("y", "-x", "z"), ("-y", "x", "z"), ("-x", "-y", "z"))


@dataclass(frozen=True)
class PoseHypothesis:
    """One thing that could be wrong.

    Attributes:
        cause: What it is, in words; empty where nothing is wrong.
        remedy: What mends it.
        rank: The likelier a cause is beforehand, the smaller.
        motions: (p, 4, 4) first_from_second of each pair that would follow; NaN where it says nothing.
    """

    cause: str
    remedy: str
    rank: int
    motions: Floats


@dataclass(frozen=True)
class PosePairs:
    """What a drive says of all its frames, and what was measured between some of them.

    Attributes:
        times_ns: (T,) times of the frames.
        world_from_ego: (T, 4, 4) poses as given.
        first: (p,) step of the earlier sweep of each pair.
        second: (p,) step of the later one.
        measured: (p, 4, 4) first_from_second, from the sweeps alone, in the ego axes that the sweeps show.
        sigma_m: (p,) standard deviation of its translation.
        sigma_rad: (p,) standard deviation of its yaw.
        unit_m: Metres in a unit of the measured translations, roughly.
    """

    times_ns: Ints
    world_from_ego: Floats
    first: Ints
    second: Ints
    measured: Floats
    sigma_m: Floats
    sigma_rad: Floats
    unit_m: float

    def __len__(self) -> int:
        return len(self.first)

    @property
    def given(self) -> Floats:
        """(p, 4, 4) first_from_second by the poses as given."""
        return self.between(self.world_from_ego)

    @property
    def dt_s(self) -> Floats:
        """(p,) time of each pair."""
        return (self.times_ns[self.second] - self.times_ns[self.first]) * 1e-9

    def between(self, world_from_ego: Array) -> Floats:
        """Return (p, 4, 4) first_from_second by other poses of the same frames."""
        return compose(inverse(world_from_ego[self.first]), world_from_ego[self.second])

    def after(self, delay_s: float) -> Floats:
        """Return (p, 4, 4) first_from_second by the poses a delay later."""
        times = self.times_ns.tolist()
        steps = sorted({*self.first.tolist(), *self.second.tolist()})
        poses = {s: pose_at(times, self.world_from_ego, times[s] + round(delay_s * 1e9)) for s in steps}
        first, second = (np.array([poses[s] for s in part.tolist()]) for part in (self.first, self.second))
        return compose(inverse(first), second)


def hypotheses(pairs: PosePairs, max_delay_s: float) -> Iterator[PoseHypothesis]:
    """Yield what could be wrong with the poses; first that nothing is.

    Args:
        pairs: Poses and measured motions.
        max_delay_s: Longest delay to try.
    """
    yield PoseHypothesis("", "", 0, pairs.given)
    upside_down = inverse(pairs.world_from_ego)
    flipped = pairs.between(upside_down)
    cause = "each pose is ego_from_world, the inverse of what is expected"
    yield PoseHypothesis(cause, correction('poses = "ego_from_world"'), 1, flipped)
    yield from _headings(pairs)
    yield from _other_axes(pairs.given, "", "")
    yield from _other_axes(flipped, "each pose is ego_from_world, and ", 'poses = "ego_from_world" and ')
    yield from _other_order(pairs)
    yield from _delays(pairs, max_delay_s)


def _other_axes(motions: Floats, cause: str, remedy: str) -> Iterator[PoseHypothesis]:
    """Yield poses of other ego axes: all permutations and mirrors."""
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        turn = np.eye(4)
        turn[:3, :3] = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.array_equal(turn, np.eye(4)):
            continue
        names = tuple(
            ("-" if sign < 0 else "") + _NAMES[axis] for axis, sign in zip(order, signs, strict=True)
        )
        is_mirror = bool(np.linalg.det(turn) < 0)
        rank = 4 + (_FREQUENT_AXES.index(names) if names in _FREQUENT_AXES else 6) + (4 if is_mirror else 0)
        rank += 10 if cause else 0
        listed = ", ".join(f'"{name}"' for name in names)
        words = f"its axes are not x forward, y left, z up: these are {', '.join(names)} of the poses"
        if is_mirror:
            words = f"left and right are swapped in the poses or in the points ({', '.join(names)})"
        line = correction(f"{remedy}pose_axes = [{listed}]")
        yield PoseHypothesis(cause + words, line, rank, compose(compose(turn, motions), _transposed(turn)))


def _transposed(turn: Array) -> Floats:
    """Return the inverse of a rotation or mirror without translation."""
    return np.asarray(turn.T)


def _headings(pairs: PosePairs) -> Iterator[PoseHypothesis]:
    """Yield paths and headings that do not belong together: mirrored, swapped, turned, degrees for radians."""
    step_m = pairs.world_from_ego[pairs.second, :3, 3] - pairs.world_from_ego[pairs.first, :3, 3]
    heading = np.unwrap(yaw_of(pairs.world_from_ego))
    for mirrored, factor in product((False, True), (1.0, -1.0, 180 / np.pi, np.pi / 180)):
        step = step_m * ((1.0, -1.0, 1.0) if mirrored else (1.0, 1.0, 1.0))
        turned = factor * heading
        way = np.arctan2(step[:, 1], step[:, 0]) - turned[pairs.first]
        length_m = np.hypot(step[:, 0], step[:, 1])
        measured_way = np.arctan2(pairs.measured[:, 1, 3], pairs.measured[:, 0, 3])
        moving = (length_m > 0.05) & (np.hypot(pairs.measured[:, 0, 3], pairs.measured[:, 1, 3]) > 0.05)
        if not moving.any():
            continue
        offset = _circular_median(measured_way[moving] - way[moving])
        if not mirrored and factor == 1.0 and _is_quarter(offset):
            continue  # other axes, or nothing wrong
        direction = way + offset
        place = np.stack([length_m * np.cos(direction), length_m * np.sin(direction), step[:, 2]], axis=1)
        motions = from_yaw(turned[pairs.second] - turned[pairs.first], place)
        cause, rank = _heading_cause(mirrored, factor, offset)
        yield PoseHypothesis(cause, f"mend the file of the poses, or {ESTIMATED}", rank, motions)


def _circular_median(angles: Floats) -> float:
    mean = np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())
    return float(wrap_angle(mean + np.median(wrap_angle(angles - mean))))


def _is_quarter(angle_rad: float) -> bool:
    """Return whether an angle is nearly a multiple of 90 degrees."""
    return bool(abs(wrap_angle(4 * angle_rad)) < 4 * np.deg2rad(4))


def _heading_cause(mirrored: bool, factor: float, offset_rad: float) -> tuple[str, int]:
    """Return a cause in words, and its rank: errors of signs and orders leave multiples of 90 degrees."""
    words, rank = _sense_cause(mirrored, factor, offset_rad)
    return words, rank if _is_quarter(offset_rad) else rank + 9


def _sense_cause(mirrored: bool, factor: float, offset_rad: float) -> tuple[str, int]:
    if factor > 1:
        return "yaw is in radians where degrees are expected: it turns 57 times too little", 3
    if 0 < factor < 1:
        return "yaw is in degrees where radians are expected: it turns 57 times too much", 3
    if mirrored and factor > 0:
        return (
            "the path is mirrored against the heading: latitude and longitude (x and y) swapped, or one negated",
            2,
        )
    if factor < 0 and not mirrored:
        return "yaw has the wrong sense: it is measured clockwise, for example from north (pi/2 - yaw)", 2
    if mirrored:
        return "left and right are swapped in the poses or in the points", 9
    return f"the heading is turned by {np.degrees(offset_rad):.0f} degrees against the path", 0


def _other_order(pairs: PosePairs) -> Iterator[PoseHypothesis]:
    """Yield poses of other frames than said: sweeps reversed; each pose a step from the one before."""
    last = len(pairs.world_from_ego) - 1
    backwards = compose(
        inverse(pairs.world_from_ego[last - pairs.first]), pairs.world_from_ego[last - pairs.second]
    )
    remedy = "sort sweeps and poses by time"
    yield PoseHypothesis("sweeps and poses run in opposite order", remedy, 2, backwards)
    steps = np.array(
        [
            _product(pairs.world_from_ego[a + 1 : b + 1])
            for a, b in zip(pairs.first, pairs.second, strict=True)
        ]
    )
    cause = "each pose is the step from the frame before, not a place in the world"
    yield PoseHypothesis(cause, f"chain the steps, or {ESTIMATED}", 6, steps.reshape(-1, 4, 4))


def _product(motions: Sequence[Array] | Array) -> Floats:
    total = np.eye(4)
    for motion in motions:
        total = compose(total, motion)
    return total


def _delays(pairs: PosePairs, max_delay_s: float, step_s: float = 0.05) -> Iterator[PoseHypothesis]:
    """Yield poses that come late or early."""
    if len(pairs.times_ns) < 3:
        return
    between_s = float(np.median(np.diff(pairs.times_ns))) * 1e-9
    for number in range(1, round(max_delay_s / step_s) + 1):
        for delay_s in (number * step_s, -number * step_s):
            frames = delay_s / between_s
            words = f"poses are {abs(delay_s):.2f} s {'late' if delay_s > 0 else 'early'}"
            if abs(frames - round(frames)) < 0.1 and round(frames):
                words += f" ({abs(round(frames))} frame{'s' if abs(round(frames)) > 1 else ''})"
            line = correction(f"pose_delay_s = {delay_s:.2f}")
            yield PoseHypothesis(words, line, 3, pairs.after(delay_s))
