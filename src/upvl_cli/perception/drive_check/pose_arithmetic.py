"""What the poses of a drive say by themselves: motions that no car makes, repeated records, jumps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.types import Array, Bools, Floats, Frame, Ints

_SKEW = 1e-3  # of a rotation times its transpose: more is no rounding
_NOISE_MPS = 3.0  # of a step of rough poses: a jump is more
_MOVES_MPS = (
    1.0  # neighbours of a repeated pose that move at least that fast show that the car does not stand
)
_FEW = 0.2  # share of steps up to which deviations are single jumps
ESTIMATED = correction('poses = "ignored"')


@dataclass(frozen=True)
class PathSteps:
    """The steps of a path, from each frame to the next.

    Attributes:
        dt_s: (T - 1,) time of each.
        motion: (T - 1, 4, 4) motion of each, in the axes of the car.
        velocity_mps: (T - 1, 3) in world axes.
        repeats: (T - 1,) whether the pose after the step is that before it.
    """

    dt_s: Floats
    motion: Floats
    velocity_mps: Floats
    repeats: Bools

    @property
    def speed_mps(self) -> Floats:
        """(T - 1,) speed."""
        return np.asarray(np.linalg.norm(self.velocity_mps, axis=1))

    @property
    def turn_rate_radps(self) -> Floats:
        """(T - 1,) rate of rotation about any axis."""
        cosine = (np.trace(self.motion[:, :3, :3], axis1=1, axis2=2) - 1) / 2
        return np.asarray(np.arccos(np.clip(cosine, -1, 1)) / self.dt_s)

    @property
    def jumps(self) -> Bools:
        """(T - 1,) whether the velocity is far from that of the steps around."""
        typical = median_filter(self.velocity_mps, size=(min(7, len(self.velocity_mps)), 1), mode="nearest")
        deviation = np.linalg.norm(self.velocity_mps - typical, axis=1)
        return np.asarray(deviation > _NOISE_MPS + 15.0 * self.dt_s)

    @property
    def single_jumps(self) -> Bools:
        """(T - 1,) jumps, where they are few and no pose repeats the one before; else none."""
        after_repeat = np.append(False, np.asarray(self.repeats)[:-1])
        jumps = np.asarray(self.jumps & ~self.repeats & ~after_repeat)
        return np.asarray(jumps if jumps.mean() <= _FEW else np.zeros_like(jumps))


def path_steps(frames: Sequence[Frame], world_from_ego: Array) -> PathSteps:
    """Return the steps of a path; steps that take no time count as a millisecond."""
    times_ns = np.array([frame.time_ns for frame in frames])
    dt_s = np.maximum(np.diff(times_ns) * 1e-9, 1e-3)
    poses = np.asarray(world_from_ego, dtype=np.float64)
    motion = compose(inverse(poses[:-1]), poses[1:])
    change = np.diff(poses, axis=0)
    repeats = np.asarray(np.abs(change).max(axis=(1, 2)) < 1e-9)
    return PathSteps(dt_s, motion, change[:, :3, 3] / dt_s[:, None], repeats)


def are_rigid(world_from_ego: Array) -> Bools:
    """Return (T,) whether each pose is a rotation and a translation of finite numbers."""
    rotation = np.asarray(world_from_ego, dtype=np.float64)[:, :3, :3]
    finite: Bools = np.asarray(np.isfinite(world_from_ego).all(axis=(1, 2)))
    rotation = np.where(finite[:, None, None], rotation, np.eye(3))
    skew = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.asarray(finite & (skew < _SKEW) & (np.linalg.det(rotation) > 0))


def check_rigid(frames: Sequence[Frame], world_from_ego: Array) -> Iterator[Finding]:
    """Yield a fault where poses are no rigid motions."""
    wrong = np.flatnonzero(~are_rigid(world_from_ego))
    if len(wrong):
        mirrored = np.linalg.det(np.nan_to_num(world_from_ego[wrong[0], :3, :3])) < 0
        cause = (
            "left-handed axes" if mirrored else "a scale, rounded numbers or missing values in the rotation"
        )
        words = f"{len(wrong)} of {len(frames)} poses are no rotation and translation"
        yield Finding("poses", "fault", words, frame_list(frames, wrong), "", cause, ESTIMATED)


def check_path(
    frames: Sequence[Frame], world_from_ego: Array, limits: MotionLimitsConfig
) -> Iterator[Finding]:
    """Yield what no car does, by the poses alone; poses that are all equal are left to the sweeps.

    Args:
        frames: All frames.
        world_from_ego: (T, 4, 4) rigid poses.
        limits: What a car can do.
    """
    if len(frames) < 3:
        return
    steps = path_steps(frames, world_from_ego)
    if steps.repeats.all():
        return
    yield from _repeats(frames, steps)
    jumps = steps.single_jumps
    if jumps.any():
        worst = int(np.argmax(np.where(jumps, steps.speed_mps, 0)))
        jump_m = float(steps.speed_mps[worst] * steps.dt_s[worst])
        words = f"the path jumps in {jumps.sum()} of {len(jumps)} steps, by up to {jump_m:.1f} m"
        cause = "a bad record, or loss of satellite reception"
        yield Finding(
            "poses",
            "fault",
            words,
            frame_list(frames, np.flatnonzero(jumps) + 1),
            "",
            cause,
            f'set poses = "refined" in odometry.toml, or {ESTIMATED.removeprefix("set ")}',
        )
    yield from _beyond_cars(frames, world_from_ego, steps, limits)


def _repeats(frames: Sequence[Frame], steps: PathSteps) -> Iterator[Finding]:
    """Yield poses that repeat the one before while the car moves."""
    moving = steps.speed_mps > _MOVES_MPS
    near = np.append(False, moving[:-1]) | np.append(moving[1:], False)
    stuck = np.flatnonzero(steps.repeats & near)
    if len(stuck):
        words = f"{len(stuck)} of {len(frames)} poses repeat the one before while the car moves"
        cause = "poses of a lower rate than the sweeps, or records that were lost"
        yield Finding("poses", "fault", words, frame_list(frames, stuck + 1), "", cause, ESTIMATED)


def _beyond_cars(
    frames: Sequence[Frame], world_from_ego: Array, steps: PathSteps, limits: MotionLimitsConfig
) -> Iterator[Finding]:
    """Yield speeds, turns and tilts that no car has."""
    fast = np.flatnonzero(steps.speed_mps > limits.max_speed_mps)
    if len(fast) > _FEW * len(steps.speed_mps):
        words = f"the car goes at {np.median(steps.speed_mps[fast]):.0f} m/s in {len(fast)} of {len(steps.dt_s)} steps"
        cause = "positions in another unit than metres, or wrong time stamps"
        yield Finding("poses", "fault", words, frame_list(frames, fast + 1), "", cause, ESTIMATED)
    spinning = np.flatnonzero(steps.turn_rate_radps > limits.max_turn_rate_radps)
    if len(spinning):
        words = (
            f"the car turns at {np.degrees(steps.turn_rate_radps[spinning].max()):.0f} degrees a second in "
            f"{len(spinning)} of {len(steps.dt_s)} steps"
        )
        cause = "degrees taken for radians, or records of the wrong frames"
        yield Finding("poses", "fault", words, frame_list(frames, spinning + 1), "", cause, ESTIMATED)
    up = np.asarray(world_from_ego)[:, :3, 2]
    mean = up.mean(axis=0)
    length = np.linalg.norm(mean)
    tilt = np.arccos(np.clip(up @ (mean / length), -1, 1)) if length > 0.1 else np.full(len(up), np.pi / 2)
    tilted = np.flatnonzero(tilt > limits.max_tilt_rad)
    if len(tilted):
        share = f"{len(tilted)} of {len(up)} poses"
        words = f"the car rolls or pitches by up to {np.degrees(tilt.max()):.0f} degrees in {share}"
        cause = "degrees taken for radians, or z of the poses is not up"
        yield Finding("poses", "fault", words, frame_list(frames, tilted), "", cause, ESTIMATED)


def frame_list(frames: Sequence[Frame], steps: Ints | Sequence[int]) -> str:
    """Return the indices of some frames in words; of many the first ones."""
    listed = [str(frames[int(step)].index) for step in list(steps)[:6]]
    more = f" and {len(steps) - 6} more" if len(steps) > 6 else ""
    return f"frame{'s' if len(steps) > 1 else ''} {', '.join(listed)}{more}"
