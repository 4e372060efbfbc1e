"""How the car moves in a sample of a drive, measured from the sweeps alone, in the axes and units of the points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.drive_check.motion_config import MotionCheckConfig
from upvl_cli.perception.drive_check.relative_motion import PlanarMotion, measure_motion
from upvl_cli.perception.drive_check.road_plane import RoadPlane, find_road, level_from_points
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.drive_check.upright_structure import UprightStructure, find_structure
from upvl_cli.types import Array, Floats, Points

# Metres in the units that points come in: metre, foot, centimetre, millimetre, kilometre.
POINT_UNITS_M = (1.0, 0.3048, 0.01, 0.001, 1000.0)


@dataclass(frozen=True)
class MeasuredPair:
    """Motion between two neighbouring sweeps.

    Attributes:
        first: Step of the earlier sweep.
        second: Step of the later one.
        dt_s: Time between them.
        time_s: Middle of the pair, after the first frame of the drive.
        planar: Motion first_from_second in level axes and metres, as far as the unit is known; None where the
            sweeps do not show it.
    """

    first: int
    second: int
    dt_s: float
    time_s: float
    planar: PlanarMotion | None


@dataclass(frozen=True)
class MotionSurvey:
    """What the sweeps of a sample show of the road and of the motion of the car.

    Attributes:
        unit_m: Metres in a unit of the points, guessed from their range: right within a factor of two or so.
        roads: The road in one sweep of each run; None where none was found.
        road: The road that most of them agree on.
        level_from_points: (3, 3) rotation from the axes of the points to level axes.
        structures: What stands above the road, by step.
        times_s: Time of these, after the first frame of the drive.
        pairs: All pairs of neighbouring sweeps.
    """

    unit_m: float
    roads: tuple[RoadPlane | None, ...]
    road: RoadPlane | None
    level_from_points: Array
    structures: Mapping[int, UprightStructure]
    times_s: Mapping[int, float]
    pairs: tuple[MeasuredPair, ...]

    @property
    def measured(self) -> tuple[MeasuredPair, ...]:
        """The pairs whose motion is known."""
        return tuple(pair for pair in self.pairs if pair.planar is not None)

    def level_motion(self, first_from_second: Array) -> Floats:
        """Return motions in the axes and units of the points as motions of level axes in metres.

        Args:
            first_from_second: (..., 4, 4) motions in the axes of the points.
        """
        turn = np.eye(4)
        turn[:3, :3] = self.level_from_points
        motion = compose(compose(turn, first_from_second), inverse(turn))
        motion[..., :3, 3] *= self.unit_m
        return motion

    def point_motions(self) -> Floats:
        """Return (p, 4, 4) first_from_second of the measured pairs in the axes and units of the points."""
        turn = np.eye(4)
        turn[:3, :3] = self.level_from_points
        level = np.array([pair.planar.matrix for pair in self.measured if pair.planar]).reshape(-1, 4, 4)
        level[:, :3, 3] /= self.unit_m
        return compose(compose(inverse(turn), level), turn)


def survey_motion(sample: DriveSample, config: MotionCheckConfig) -> MotionSurvey:
    """Measure road and motion in a sample, without its poses.

    Args:
        sample: Sweeps of the drive.
        config: Settings of each step.
    """
    heads = [sample.sweep(run[0]) for run in sample.runs if run]
    unit_m = guess_unit([points.xyz_ego_m for points in heads], config.structure.typical_range_m)
    roads = tuple(find_road(points.xyz_ego_m.astype(np.float64) * unit_m, config.road) for points in heads)
    road = _consensus(roads)
    turn = level_from_points(road)
    needed = {step for pair in sample.pairs for step in pair}
    sweeps = {step: sample.sweep(step) for step in sorted(needed)}
    structures = {
        step: find_structure(
            (points.xyz_ego_m.astype(np.float64) * unit_m) @ turn.T,
            points.time_offset_ns * 1e-9,
            config.structure,
        )
        for step, points in sweeps.items()
    }
    pairs = [
        _measure(sample, pair, structures, config)
        if _comparable(sample, pair, sweeps, config)
        else MeasuredPair(*pair, sample.seconds(*pair), _middle_s(sample, pair), None)
        for pair in sample.pairs
    ]
    times_s = {step: sample.seconds(0, step) for step in structures}
    looked = _second_look(pairs, structures, config)
    return MotionSurvey(unit_m, roads, road, turn, structures, times_s, tuple(looked))


def guess_unit(sweeps: Sequence[Array], typical_range_m: float) -> float:
    """Return metres in a unit of the points: the unit that brings their median range nearest to that of streets."""
    ranges = [np.median(np.linalg.norm(xyz[::20], axis=1)) for xyz in sweeps if len(xyz)]
    range_units = float(np.median(ranges)) if ranges else typical_range_m
    if not range_units > 0:
        return 1.0
    distance = [abs(np.log(range_units * unit / typical_range_m)) for unit in POINT_UNITS_M]
    return POINT_UNITS_M[int(np.argmin(distance))]


def _consensus(roads: Sequence[RoadPlane | None]) -> RoadPlane | None:
    """Return the road with the axis that most agree on and the mean of their normals and heights."""
    found = [road for road in roads if road is not None]
    if not found:
        return None
    axes = [road.axis for road in found]
    axis = max(sorted(set(axes)), key=axes.count)
    same = [road for road in found if road.axis == axis]
    normal = np.median([road.normal for road in same], axis=0)
    height_m = float(np.median([road.height_m for road in same]))
    support = np.sum([road.support for road in found], axis=0)
    return replace(same[0], normal=normal / np.linalg.norm(normal), height_m=height_m, support=support)


def _comparable(
    sample: DriveSample, pair: tuple[int, int], sweeps: Mapping[int, Points], config: MotionCheckConfig
) -> bool:
    """Return whether two sweeps are near in time and not the same sweep twice."""
    first, second = (sweeps[step].xyz_ego_m for step in pair)
    if not 0 < sample.seconds(*pair) <= config.limits.max_gap_s:
        return False
    return len(first) != len(second) or not np.array_equal(first, second)


def _measure(
    sample: DriveSample,
    pair: tuple[int, int],
    structures: Mapping[int, UprightStructure],
    config: MotionCheckConfig,
) -> MeasuredPair:
    first, second = pair
    dt_s = sample.seconds(first, second)
    planar = measure_motion(structures[second], structures[first], dt_s, config.registration)
    return MeasuredPair(first, second, dt_s, _middle_s(sample, pair), planar)


def _middle_s(sample: DriveSample, pair: tuple[int, int]) -> float:
    return sum(sample.seconds(0, step) for step in pair) / 2


def _second_look(
    pairs: list[MeasuredPair], structures: Mapping[int, UprightStructure], config: MotionCheckConfig
) -> list[MeasuredPair]:
    """Measure those pairs again that deviate from their neighbours in time, from the velocity of these."""
    looked = []
    for place, pair in enumerate(pairs):
        near = [other for other in pairs[max(place - 2, 0) : place + 3] if other.planar is not None]
        usable = pair.planar is not None or pair.dt_s <= config.limits.max_gap_s
        if len(near) < 3 or not usable or pair.dt_s <= 0:
            looked.append(pair)
            continue
        velocity = np.median([other.planar.vector / other.dt_s for other in near if other.planar], axis=0)
        apart_s = max(other.dt_s for other in near)
        guess = velocity * pair.dt_s
        change = config.limits.max_acceleration_mps2 * apart_s * pair.dt_s
        if pair.planar is not None and np.abs(pair.planar.vector - guess)[:2].max() < change:
            looked.append(pair)
            continue
        planar = measure_motion(
            structures[pair.second], structures[pair.first], pair.dt_s, config.registration, guesses=(guess,)
        )
        looked.append(replace(pair, planar=planar))
    return looked
