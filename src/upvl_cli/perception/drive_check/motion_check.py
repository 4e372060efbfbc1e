"""Checks of axes, poses and motion compensation: what the sweeps show of the motion against what the drive says."""

from __future__ import annotations

from collections.abc import Iterator

from upvl_cli.perception.drive_check.axes_check import check_axes, estimate_axes
from upvl_cli.perception.drive_check.compensation_check import check_compensation, estimate_compensation
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.motion_config import MotionCheckConfig
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey, survey_motion
from upvl_cli.perception.drive_check.pose_arithmetic import check_path, check_rigid
from upvl_cli.perception.drive_check.pose_cause import UNKNOWN
from upvl_cli.perception.drive_check.pose_check import REFINED, check_agreement, check_constant
from upvl_cli.perception.drive_check.pose_rounding import check_rounding
from upvl_cli.perception.drive_check.sample import DriveSample


def check_motion(
    sample: DriveSample,
    config: MotionCheckConfig,
    survey: MotionSurvey | None = None,
    *,
    is_quick: bool = False,
) -> Iterator[Finding]:
    """Yield the findings on axes, poses and motion compensation.

    Args:
        sample: Sweeps and poses of the drive.
        config: Settings.
        survey: Motion by the sweeps alone, where it was measured already.
        is_quick: Whether motion compensation, which takes seconds, is left out.
    """
    survey = survey or survey_motion(sample, config)
    axes = estimate_axes(survey, config.limits)
    yield from check_axes(axes, survey, poses_decide=sample.world_from_ego is not None)
    yield from check_poses(sample, config, survey)
    if not is_quick:
        yield from check_compensation(estimate_compensation(survey, config))


def check_poses(
    sample: DriveSample, config: MotionCheckConfig, survey: MotionSurvey | None = None
) -> Iterator[Finding]:
    """Yield the findings on poses: each by itself, the path, and both against the sweeps.

    Args:
        sample: Sweeps and poses of the drive.
        config: Settings.
        survey: Motion by the sweeps alone, where it was measured already.
    """
    poses = sample.world_from_ego
    if poses is None:
        yield Finding("poses", "ok", "the drive has none: they are estimated from the sweeps")
        return
    broken = list(check_rigid(sample.frames, poses))
    yield from broken
    if broken:
        return
    by_themselves = [
        *check_rounding(poses, config.limits, REFINED),
        *check_path(sample.frames, poses, config.limits),
    ]
    yield from by_themselves
    survey = survey or survey_motion(sample, config)
    constant = list(check_constant(sample, survey, config.limits))
    yield from constant
    if not constant:
        axes = estimate_axes(survey, config.limits)
        for finding in check_agreement(sample, survey, axes, config.limits):
            is_consequence = finding.cause.startswith(UNKNOWN) or finding.remedy == REFINED
            if not (by_themselves and is_consequence):
                yield finding
