"""Which way the axes of the points look: up by the road, forward by the motion of the car."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey
from upvl_cli.perception.drive_check.road_plane import AXES, DIRECTIONS
from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class AxesEstimate:
    """Axes of the car in terms of the axes of the points.

    Attributes:
        up: Such as "z"; empty where the sweeps do not show it.
        forward: Such as "x"; empty where the car stands or the road is not found.
        up_error_rad: Angle between up and that axis.
        forward_error_rad: Angle between the motion and that axis.
        moving: Pairs of sweeps in which the car moves.
        backward: Of these, pairs in which it moves against most others.
        speed_mps: Median speed in them, in metres as far as the unit is known.
        level_turn: (3, 3) rotation from the axes of the points to axes along motion and road, to the degree.
        max_error_rad: Angle from which axes are oblique.
    """

    up: str
    forward: str
    up_error_rad: float = 0.0
    forward_error_rad: float = 0.0
    moving: int = 0
    backward: int = 0
    speed_mps: float = 0.0
    level_turn: Array | None = None
    max_error_rad: float = np.inf

    @property
    def names(self) -> tuple[str, str, str]:
        """Forward, left and up of the car; what is not known is as it should be, where that is possible."""
        up = self.up or "z"
        forward = self.forward or ("x" if up in ("z", "-z") else "x" if up[-1] != "x" else "y")
        left = np.cross(_direction(up), _direction(forward))
        return forward, AXES[int(np.argmax(DIRECTIONS @ left))], up

    @property
    def ego_from_points(self) -> Floats:
        """(3, 3) rotation from the axes of the points to x forward, y left, z up."""
        if self.is_oblique and self.level_turn is not None:
            return self.level_turn
        return np.stack([_direction(name) for name in self.names])

    @property
    def is_oblique(self) -> bool:
        """Whether up or forward lies between the axes."""
        return max(self.up_error_rad, self.forward_error_rad) > self.max_error_rad

    @property
    def is_right(self) -> bool:
        """Whether nothing says that the axes are not x forward, y left, z up."""
        return not self.is_oblique and self.up in ("", "z") and self.forward in ("", "x")

    @property
    def is_reverse(self) -> bool:
        """Whether all is right but that the car moves backwards."""
        return not self.is_oblique and self.up == "z" and self.forward == "-x"


def _direction(name: str) -> Array:
    return np.asarray(DIRECTIONS[AXES.index(name)])


def estimate_axes(survey: MotionSurvey, limits: MotionLimitsConfig) -> AxesEstimate:
    """Return which axes of the points look up and forward."""
    road = survey.road
    if road is None or not road.is_clear:
        return AxesEstimate("", "")
    up_error = float(np.arccos(np.clip(road.normal @ _direction(road.axis), -1, 1)))
    moving = [
        pair.planar.vector[:2] / pair.dt_s
        for pair in survey.measured
        if pair.planar and np.hypot(*pair.planar.vector[:2]) > limits.min_speed_mps * pair.dt_s
    ]
    if not moving:
        return AxesEstimate(road.axis, "", up_error, max_error_rad=limits.max_axis_error_rad)
    velocity = np.array(moving)
    speed = np.linalg.norm(velocity, axis=1)
    main = _main_direction(velocity)
    along = np.append(main, 0.0) @ survey.level_from_points  # in the axes of the points
    free = [name for name in AXES if name[-1] != road.axis[-1]]
    forward = max(free, key=lambda name: float(_direction(name) @ along))
    error = float(np.arccos(np.clip(_direction(forward) @ along, -1, 1)))
    backward = int((velocity @ main < 0).sum())
    ahead = np.array([[main[0], main[1], 0.0], [-main[1], main[0], 0.0], [0.0, 0.0, 1.0]])
    return AxesEstimate(
        up=road.axis,
        forward=forward,
        up_error_rad=up_error,
        forward_error_rad=error,
        moving=len(speed),
        backward=backward,
        speed_mps=float(np.median(speed)),
        level_turn=ahead @ survey.level_from_points,
        max_error_rad=limits.max_axis_error_rad,
    )


def _main_direction(velocity: Floats) -> Floats:
    """Return the (2,) unit vector along which the car moves, forward in most pairs."""
    angle = np.arctan2(velocity[:, 1], velocity[:, 0])
    axis = np.arctan2(np.sin(2 * angle).mean(), np.cos(2 * angle).mean()) / 2  # sense does not count
    main = np.array([np.cos(axis), np.sin(axis)])
    return main if (velocity @ main).sum() >= 0 else -main


def check_axes(axes: AxesEstimate, survey: MotionSurvey, *, poses_decide: bool) -> Iterator[Finding]:
    """Yield what the sweeps say of their axes.

    Args:
        axes: Up and forward.
        survey: What they come from.
        poses_decide: Whether poses will say why the car moves backwards.
    """
    if not axes.up:
        yield Finding(
            "axes", "cannot tell", "the road is not clear enough in the sweeps to tell which way is up"
        )
        return
    evidence = f"road found in {sum(road is not None for road in survey.roads)} of {len(survey.roads)} sweeps"
    if axes.moving:
        evidence += f", car moves in {axes.moving} of {len(survey.measured)} pairs of sweeps"
    forward, left, up = axes.names
    line = correction(f'axes = ["{forward}", "{left}", "{up}"]')
    if axes.is_oblique:
        yield _oblique(axes, evidence)
    elif axes.up != "z":
        words = f"the road lies across {axes.up}, so that {axes.up} is up and not z"
        if axes.forward:
            words += f"; the car moves along {axes.forward}"
        else:
            line += "; the car stands, so look at the pictures for which way is forward"
        yield Finding("axes", "fault", words, "", evidence, "axes of another convention", line)
    elif axes.is_reverse:
        if not poses_decide:
            yield _reverse(axes, evidence, line)
    elif axes.forward and axes.forward != "x":
        words = f"the car moves along {axes.forward}, not along x"
        yield Finding("axes", "fault", words, "", evidence, "axes of the points turned about z", line)
    elif not axes.forward:
        words = "z is up; the car stands or its motion is not seen, so that forward cannot be told"
        yield Finding("axes", "cannot tell", words, "", evidence)
    else:
        yield Finding("axes", "ok", "z is up and the car moves along x", "", evidence)


def _oblique(axes: AxesEstimate, evidence: str) -> Finding:
    """Return the finding on axes between those of the car."""
    if axes.up_error_rad > axes.max_error_rad:
        words = f"up is {np.degrees(axes.up_error_rad):.0f} degrees off {axes.up}"
    else:
        assert axes.level_turn is not None
        turn_deg = np.degrees(np.arctan2(axes.level_turn[0, 1], axes.level_turn[0, 0]))
        words = f"the car moves at {turn_deg:.0f} degrees from x, {np.degrees(axes.forward_error_rad):.0f} off its axis"
    cause = "the mounting of the LiDAR is not taken out of the points"
    return Finding("axes", "fault", words, "", evidence, cause, "turn the points into the axes of the car")


def _reverse(axes: AxesEstimate, evidence: str, line: str) -> Finding:
    """Return the finding on a car that moves backwards: faster than cars do that, it is a fault."""
    words = f"the car moves backwards at {axes.speed_mps:.1f} m/s, along -x"
    cause = "axes of the points turned by 180 degrees, or sweeps in reversed order"
    is_slow = axes.speed_mps < 4.0  # no car backs up faster for long
    cause = f"the car backs up, or {cause}" if is_slow else cause
    return Finding(
        "axes",
        "warning" if is_slow else "fault",
        words,
        "",
        evidence,
        cause,
        f"{line}, or sort the sweeps by time",
    )
