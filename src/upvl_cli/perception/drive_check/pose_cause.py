"""The likely cause where poses contradict sweeps."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.drive_check.finding import correction
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey
from upvl_cli.perception.drive_check.pose_arithmetic import ESTIMATED
from upvl_cli.perception.drive_check.pose_fit import PoseFit, best_explanations
from upvl_cli.perception.drive_check.pose_hypotheses import PoseHypothesis, PosePairs, hypotheses

# Units that positions and points come in, in metres.
UNITS_M = {
    "feet": 0.3048, "yards": 0.9144, "miles": 1609.344, "inches": 0.0254, "centimetres": 0.01, "decimetres": 0.1,
    "millimetres": 0.001, "kilometres": 1000.0, "degrees of latitude": 111_320.0,
}  # fmt: skip
_UNIT_TOLERANCE = 0.04
# LiDARs on cars are that high above the road; one whose axes stand on the road shows no height.
_LIDAR_HEIGHT_M = (1.0, 3.5)
_MOST_CAUSES = 3
UNKNOWN = "not known"


def name_cause(
    pairs: PosePairs, survey: MotionSurvey, limits: MotionLimitsConfig
) -> tuple[str, str, PoseFit | None]:
    """Return cause, remedy and the fit once it is mended, or None where no cause explains the sweeps.

    Args:
        pairs: Poses and measured motions that disagree.
        survey: Where the measured motions come from.
        limits: Tolerances.
    """
    candidates = list(hypotheses(pairs, limits.max_delay_s))
    for free_scale in (False, True):
        found = best_explanations(candidates, pairs, limits, free_scale=free_scale)
        if found:
            break
    else:
        words = f"{UNKNOWN}: none of {len(candidates)} possible errors of poses explains the sweeps"
        return words, ESTIMATED, None
    found = _likeliest(found)
    best, fit = found[0]
    if free_scale:
        scale_cause, scale_remedy = _scale_cause(fit.scale, pairs, survey)
        cause = scale_cause + (f"; also {best.cause}" if best.cause else "")
        return cause, scale_remedy if not best.cause else f"{scale_remedy}; {best.remedy}", fit
    causes = list(dict.fromkeys(_mend(candidate, pairs)[0] for candidate, _ in found))[:_MOST_CAUSES]
    cause = causes[0] if len(causes) == 1 else "one of: " + "; or ".join(causes)
    return cause, _mend(best, pairs)[1], fit


def _mend(candidate: PoseHypothesis, pairs: PosePairs) -> tuple[str, str]:
    """Return cause and remedy; of points turned by 180 degrees what is turned is seen by the sense of the motion."""
    is_half_turn = candidate.remedy.startswith('set pose_axes = ["-x", "-y", "z"]')
    if is_half_turn and np.median(pairs.measured[:, 0, 3]) < 0:
        line = correction('axes = ["-x", "-y", "z"]')
        return "axes of the points turned by 180 degrees", line
    return candidate.cause, candidate.remedy


def _likeliest(found: list[tuple[PoseHypothesis, PoseFit]]) -> list[tuple[PoseHypothesis, PoseFit]]:
    """Return those of the explanations that are not much less likely beforehand than the first."""
    lowest = found[0][0].rank
    return [item for item in found if item[0].rank <= lowest + 1]


def _scale_cause(scale: float, pairs: PosePairs, survey: MotionSurvey) -> tuple[str, str]:
    """Return cause and remedy where a step of the poses times `scale` is a step of the sweeps.

    The height of the LiDAR above the road says which of both is not in metres.
    """
    height = abs(survey.road.height_m) / survey.unit_m if survey.road else 0.0  # in units of the points
    points_m = 1 / scale  # metres in a unit of the points, were the poses in metres
    low_m, high_m = _LIDAR_HEIGHT_M
    of_points = f"points are in {_unit_name(points_m)}, not in metres"
    of_poses = f"positions of the poses are in {_unit_name(scale)}, not in metres"
    points_line = correction(f"metres_per_unit = {_snap(points_m):.4g}")
    poses_line = f"multiply the positions by {_snap(scale):.4g}, or {ESTIMATED}"
    if low_m < height < high_m:
        return of_poses, poses_line
    is_far_off = survey.unit_m < 0.1 or survey.unit_m > 10  # the range of the points is no measure of feet
    if low_m < height * points_m < high_m or is_far_off:
        return of_points, points_line
    return f"one of: {of_points}; or {of_poses}", f"{points_line}, or {poses_line}"


def _unit_name(unit_m: float) -> str:
    for name, known_m in UNITS_M.items():
        if abs(np.log(unit_m / known_m)) < _UNIT_TOLERANCE:
            return name
    return f"units of {unit_m:.3g} m"


def _snap(unit_m: float) -> float:
    """Return the known unit near that one, or itself."""
    known = [known_m for known_m in UNITS_M.values() if abs(np.log(unit_m / known_m)) < _UNIT_TOLERANCE]
    return known[0] if known else unit_m
