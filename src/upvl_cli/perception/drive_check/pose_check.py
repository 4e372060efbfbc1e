"""Whether the poses of a drive agree with its sweeps, and what is wrong where they do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from upvl_cli.geometry.se3 import apply, compose, inverse
from upvl_cli.perception.drive_check.axes_check import AxesEstimate
from upvl_cli.perception.drive_check.finding import Finding, Level, correction
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey
from upvl_cli.perception.drive_check.pose_arithmetic import ESTIMATED, frame_list, path_steps
from upvl_cli.perception.drive_check.pose_cause import name_cause
from upvl_cli.perception.drive_check.pose_delay import PoseDelay, estimate_delay
from upvl_cli.perception.drive_check.pose_fit import PoseFit, fit_motions
from upvl_cli.perception.drive_check.pose_hypotheses import PosePairs
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.drive_check.turn_ratio import estimate_turn_ratio
from upvl_cli.types import Floats

REFINED = 'set poses = "refined" in odometry.toml'
_EVIDENCE_PAIRS = 6  # pairs of sweeps that the distance of static points is measured in


def pose_pairs(sample: DriveSample, survey: MotionSurvey, axes: AxesEstimate) -> PosePairs | None:
    """Return poses and measured motions side by side; None where there is nothing to compare.

    Motions are brought into the axes of the car that the sweeps show, but where these say that the car moves
    backwards: then poses may know better.
    """
    if sample.world_from_ego is None or not survey.measured:
        return None
    measured = survey.point_motions()
    if not axes.is_right and not axes.is_reverse:
        turn = np.eye(4)
        turn[:3, :3] = axes.ego_from_points
        measured = compose(compose(turn, measured), inverse(turn))
    planar = [pair.planar for pair in survey.measured if pair.planar]
    covariance = np.array([motion.covariance for motion in planar])
    return PosePairs(
        times_ns=np.array([frame.time_ns for frame in sample.frames]),
        world_from_ego=np.asarray(sample.world_from_ego, dtype=np.float64),
        first=np.array([pair.first for pair in survey.measured]),
        second=np.array([pair.second for pair in survey.measured]),
        measured=measured,
        sigma_m=np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1]) / survey.unit_m,
        sigma_rad=np.sqrt(covariance[:, 2, 2]),
        unit_m=survey.unit_m,
    )


def check_agreement(
    sample: DriveSample, survey: MotionSurvey, axes: AxesEstimate, limits: MotionLimitsConfig
) -> Iterator[Finding]:
    """Yield whether the poses move the car as the sweeps do.

    Args:
        sample: Poses, times and sweeps.
        survey: Motion by the sweeps alone.
        axes: Axes by the sweeps alone.
        limits: Tolerances.
    """
    pairs = pose_pairs(sample, survey, axes)
    if pairs is None:
        yield Finding(
            "poses", "cannot tell", "no two sweeps show how the car moves, so that poses cannot be compared"
        )
        return
    fit = fit_motions(pairs.given, pairs, limits)
    evidence = f"{int(fit.agrees.sum())} of {len(pairs)} pairs of sweeps agree"
    if fit.share >= limits.min_agreeing_share:
        systematic = _systematic(pairs, survey, fit, evidence, limits)
        yield from systematic or _agreement(sample, pairs, fit, evidence, limits)
        return
    static = static_distance(survey, pairs)
    cause, remedy, found = name_cause(pairs, survey, limits)
    if (found is None or found.share < 0.95) and _is_rough(pairs, fit):  # interpolation hides some noise
        smooth = fit_motions(pairs.between(smooth_positions(pairs, limits.smoothing_s)), pairs, limits)
        level: Level = "fault" if smooth.share < limits.min_agreeing_share else "warning"
        words = f"steps of the path scatter by {_scatter_m(fit) * survey.unit_m:.2f} m; {static}"
        yield Finding("poses", level, words, "", evidence, "positions are rounded or noisy", REFINED)
        return
    if found is not None:
        evidence += f"; {int(found.agrees.sum())} once that is mended"
    worst = np.argsort(-fit.error, kind="stable")[:3]
    where = frame_list(sample.frames, np.sort(pairs.second[worst]))
    words = f"they contradict the sweeps: {_typical(pairs, survey)}; {static}"
    yield Finding("poses", "fault", words, f"most in {where}", evidence, cause, remedy)


def _systematic(
    pairs: PosePairs, survey: MotionSurvey, fit: PoseFit, evidence: str, limits: MotionLimitsConfig
) -> list[Finding]:
    """Return a fault where errors within the tolerance are not noise: a cause explains them clearly better."""
    size_m = np.hypot(fit.offset_m[fit.agrees, 0], fit.offset_m[fit.agrees, 1])
    speed_mps = float(np.median(size_m / pairs.dt_s[fit.agrees])) * pairs.unit_m
    if speed_mps < limits.roughness_mps:
        return []
    cause, remedy, found = name_cause(pairs, survey, limits)
    if found is None or not cause:
        return []
    words = f"their steps differ from the sweeps by {speed_mps:.2f} m/s, and not by chance: {_typical(pairs, survey)}"
    return [Finding("poses", "fault", words, "", evidence, cause, remedy)]


def _typical(pairs: PosePairs, survey: MotionSurvey) -> str:
    """Return typical steps by poses and by sweeps in words."""
    texts = []
    for motion in (pairs.given, pairs.measured):
        step = np.median(motion[:, :3, 3], axis=0)
        texts.append(f"({step[0]:.2f}, {step[1]:.2f}, {step[2]:.2f})")
    return f"a step is {texts[0]} by the poses and {texts[1]} by the sweeps"


def static_distance(survey: MotionSurvey, pairs: PosePairs) -> str:
    """Return in words how far points above the road lie from those of the sweep before, with the poses and without."""
    chosen = np.unique(np.linspace(0, len(pairs) - 1, _EVIDENCE_PAIRS).round().astype(int))
    claimed = survey.level_motion(pairs.given)
    rows = []
    for number in chosen.tolist():
        pair = survey.measured[number]
        assert pair.planar is not None
        source, target = survey.structures[pair.second], survey.structures[pair.first]
        rows.append([
            float(np.median(target.tree.query(target.search_places(apply(motion, source.xyz_m)))[0]))
            for motion in (claimed[number], pair.planar.matrix)
        ])  # fmt: skip
    poses_m, sweeps_m = np.median(rows, axis=0)
    return f"static points lie {poses_m:.2f} m apart with the poses, {sweeps_m:.2f} m without"


def _is_rough(pairs: PosePairs, fit: PoseFit) -> bool:
    """Return whether the path follows the sweeps in the mean, and only its steps scatter."""
    if len(pairs) < 3:
        return False
    finite = np.isfinite(fit.error)
    step_m = float(np.median(np.linalg.norm(pairs.measured[:, :3, 3], axis=1)))
    mean_m = float(np.linalg.norm(fit.offset_m[finite, :2].mean(axis=0)))
    standard_error_m = _scatter_m(fit) / np.sqrt(finite.sum())
    yaw_agrees = np.abs(fit.yaw_rad) < 0.05
    return mean_m < 0.1 * step_m + 2 * standard_error_m < 0.7 * step_m and bool(yaw_agrees.mean() > 0.8)


def _scatter_m(fit: PoseFit) -> float:
    """Return the root mean square error of a step, in the plane and units of the points."""
    finite = np.isfinite(fit.offset_m).all(axis=1)
    return float(np.sqrt((fit.offset_m[finite, :2] ** 2).sum(axis=1).mean())) if finite.any() else 0.0


def smooth_positions(pairs: PosePairs, half_window_s: float) -> Floats:
    """Return (T, 4, 4) poses; positions that pairs need follow a parabola through those near in time."""
    poses = pairs.world_from_ego.copy()
    times_s = (pairs.times_ns - pairs.times_ns[0]) * 1e-9
    for step in sorted({*pairs.first.tolist(), *pairs.second.tolist()}):
        near = np.flatnonzero(np.abs(times_s - times_s[step]) <= half_window_s * 1.01)
        if len(near) > 3:
            powers = np.vander(times_s[near] - times_s[step], 3, increasing=True)
            poses[step, :3, 3] = np.linalg.lstsq(powers, pairs.world_from_ego[near, :3, 3], rcond=None)[0][0]
    return poses


def _agreement(
    sample: DriveSample, pairs: PosePairs, fit: PoseFit, evidence: str, limits: MotionLimitsConfig
) -> Iterator[Finding]:
    """Yield the findings on poses that agree on the whole: single steps, roughness, sense of turns, delay."""
    jumps = np.append(False, path_steps(sample.frames, pairs.world_from_ego).single_jumps)
    off = ~fit.agrees & ~jumps[pairs.second]
    if off.any():
        words = f"they differ from the sweeps by {np.linalg.norm(fit.offset_m[off], axis=1).max() * pairs.unit_m:.2f} m"
        where = frame_list(sample.frames, pairs.second[off])
        yield Finding("poses", "warning", words, where, evidence, "bad records", REFINED)
    smooth = fit_motions(pairs.between(smooth_positions(pairs, limits.smoothing_s)), pairs, limits)
    smooth_mps = (
        float(
            np.sqrt(np.mean((smooth.offset_m[fit.agrees, :2] ** 2).sum(axis=1) / pairs.dt_s[fit.agrees] ** 2))
        )
        * pairs.unit_m
    )
    turn = estimate_turn_ratio(pairs)
    turn_cause = turn.cause(limits) if turn else ""
    delay = estimate_delay(pairs, limits)
    if smooth_mps > limits.roughness_mps and not jumps.any():
        words = f"steps differ from the sweeps by {smooth_mps:.2f} m/s even after smoothing"
        yield Finding("poses", "warning", words, "", evidence, "positions are rounded or noisy", REFINED)
    elif turn and turn_cause:
        words = f"the car turns {turn.value:.2f} times as much by the sweeps as by the poses"
        evidence += f"; standard deviation {turn.sigma:.2f}"
        yield Finding("poses", "fault", words, "", evidence, turn_cause, ESTIMATED)
    elif delay is not None and delay.is_clear(limits):
        words = f"they are {abs(delay.seconds):.3f} s {'late' if delay.seconds > 0 else 'early'}"
        line = correction(f"pose_delay_s = {delay.seconds:.3f}")
        evidence += f"; standard deviation {delay.sigma_s:.3f} s"
        yield Finding("poses", "warning", words, "", evidence, "clocks of poses and sweeps differ", line)
    elif not off.any():
        yield _good(pairs, fit, evidence, delay, limits)


def _good(
    pairs: PosePairs, fit: PoseFit, evidence: str, delay: PoseDelay | None, limits: MotionLimitsConfig
) -> Finding:
    """Return the finding on poses that are right, with what they would show."""
    speed_mps = np.linalg.norm(pairs.measured[:, :3, 3], axis=1) * pairs.unit_m / pairs.dt_s
    if not (speed_mps > limits.min_speed_mps).any():
        words = (
            "poses and sweeps agree that the car stands in all sweeps looked at: a moving car would show more"
        )
        return Finding("poses", "ok", words, "", evidence)
    cm = float(np.median(np.hypot(fit.offset_m[:, 0], fit.offset_m[:, 1]))) * pairs.unit_m * 100
    words = f"poses agree with the sweeps within {cm:.1f} cm a step"
    if delay is None:
        words += "; speed and turn change too little to show a delay"
    else:
        words += (
            f"; a delay would show from {max(limits.sigmas * delay.sigma_s, limits.min_delay_s):.2f} s on"
        )
    return Finding("poses", "ok", words, "", evidence)


def check_constant(
    sample: DriveSample, survey: MotionSurvey, limits: MotionLimitsConfig
) -> Iterator[Finding]:
    """Yield a fault where all poses are equal while the sweeps move."""
    poses = sample.world_from_ego
    if poses is None or len(poses) < 2 or not path_steps(sample.frames, poses).repeats.all():
        return
    moving = [
        pair for pair in survey.measured
        if pair.planar and np.hypot(*pair.planar.vector[:2]) > limits.min_speed_mps * pair.dt_s
    ]  # fmt: skip
    if len(moving) * 2 > len(survey.measured):
        speed = np.median([np.hypot(*pair.planar.vector[:2]) / pair.dt_s for pair in moving if pair.planar])
        words = f"all {len(poses)} poses are equal while the car moves at {speed:.1f} m/s by the sweeps"
        evidence = f"{len(moving)} of {len(survey.measured)} pairs of sweeps"
        yield Finding(
            "poses", "fault", words, "", evidence, "one record is repeated for all frames", ESTIMATED
        )
