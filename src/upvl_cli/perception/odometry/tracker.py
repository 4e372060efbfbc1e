"""Placement of sweep after sweep in a local map, and the judgement of each placement."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import compose, inverse, yaw_of
from upvl_cli.perception.odometry.agreement import Agreement, Structure, align_structure, measure_agreement
from upvl_cli.perception.odometry.config import LidarOdometryConfig
from upvl_cli.perception.odometry.constant_velocity import motion_over, velocity_between
from upvl_cli.perception.odometry.local_map import LocalMap
from upvl_cli.perception.odometry.motion_search import Reach, search_motion
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.types import Array, Floats

MIN_POINTS = 50  # fewer points to register say nothing of six numbers
_REMEMBERED = 20  # placements whose share of partners is the usual one
_BASELINE_S = 1.0  # a velocity is averaged over at most so long: a car's changes
_POOR = 0.5  # a sweep with less than this part of the usual upright points is not what others are judged by
_NO_GUESS_M = 10.0  # standard deviation of a guess that says nothing
_GAP = 1.8  # a step so many times the usual one is a gap


@dataclass(frozen=True)
class Placement:
    """The pose of one sweep, or where it would be if the motion had gone on.

    Attributes:
        time_s: Time of the frame.
        world_from_ego: (4, 4) pose.
        twist: (6,) velocity of the car there.
        is_placed: Whether the sweep gave the pose.
        is_bridged: Whether it was placed after a gap in time, or by a new search.
        agreement: How well it fits the sweep that it is compared with; None where there is none.
        reference_s: Time of that sweep: the last one placed that saw enough.
    """

    time_s: float
    world_from_ego: Array
    twist: Floats
    is_placed: bool
    is_bridged: bool
    agreement: Agreement | None
    reference_s: float = 0.0


@dataclass(frozen=True)
class Reference:
    """The sweep that the next ones are compared with: its time, (4, 4) pose and upright points."""

    time_s: float
    world_from_ego: Array
    structure: Structure


class Tracker:
    """The state of odometry: the map, the last poses, and how well sweeps fitted so far."""

    def __init__(
        self, first: PreparedSweep, world_from_ego: Array, twist: Floats, config: LidarOdometryConfig
    ) -> None:
        """Begin at a pose with a velocity.

        Args:
            first: The first sweep.
            world_from_ego: (4, 4) its pose.
            twist: (6,) velocity of the car (m/s, rad/s).
            config: The method's settings.
        """
        self._config = config
        self._map = LocalMap(config.kiss_icp)
        self._twist = twist
        self._poses: deque[tuple[float, Array]] = deque()
        self._reference: Reference
        self._map_sweeps = 0
        self._sizes: deque[int] = deque(maxlen=_REMEMBERED)
        self._shares: deque[float] = deque(maxlen=_REMEMBERED)
        self._steps_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._commit(first, world_from_ego)

    @property
    def last_time_s(self) -> float:
        """Time of the last placed sweep."""
        return self._poses[-1][0]

    def predict(self, time_s: float) -> Array:
        """Return the (4, 4) pose at a time, by constant velocity from the last placed sweep."""
        return compose(self._poses[-1][1], motion_over(self._velocity(time_s), time_s - self._poses[-1][0]))

    def follow(self, sweep: PreparedSweep) -> Placement:
        """Place a sweep by the predicted motion alone, however badly it fits."""
        twist, predicted = self._velocity(sweep.time_s), self.predict(sweep.time_s)
        pose, agreement = self._register(sweep, twist, predicted)
        return self._place(sweep, predicted, pose, agreement, is_bridged=False)

    def place(self, sweep: PreparedSweep) -> Placement:
        """Place a sweep: by the predicted motion, by a search where that fits badly, or not at all."""
        seconds = sweep.time_s - self.last_time_s
        twist, predicted = self._velocity(sweep.time_s), self.predict(sweep.time_s)
        is_gap = bool(self._steps_s) and seconds > _GAP * float(np.median(self._steps_s))
        best: tuple[Array, Agreement] | None = None
        if len(sweep.source) >= MIN_POINTS:
            best = self._register(sweep, twist, predicted)
            if is_gap or not self._is_usual(predicted, *best, seconds):
                starts = self._search(sweep, twist, predicted, seconds)
                found = [best, *(self._register(sweep, twist, start) for start in starts)]
                found = [each for each in found if self._is_possible(predicted, each[0], seconds)]
                radius_m = self._config.agreement.partner_m
                best = min(found, key=lambda each: each[1].error_m2(radius_m), default=None)
                is_gap = True
        if best is None or not self._fits(best[1]):
            return Placement(sweep.time_s, predicted, twist, False, False, None)
        return self._place(sweep, predicted, *best, is_bridged=is_gap)

    def _velocity(self, time_s: float) -> Floats:
        """Return the (6,) velocity for a prediction: over as long a time before as it is predicted ahead."""
        last_s, last = self._poses[-1]
        ahead_s = min(time_s - last_s, _BASELINE_S)
        before = next((known for known in reversed(self._poses) if last_s - known[0] >= 0.9 * ahead_s), None)
        before = before or self._poses[0]
        if before[0] == last_s:
            return self._twist
        return velocity_between(before[1], last, last_s - before[0])

    def _register(self, sweep: PreparedSweep, twist: Floats, guess: Array) -> tuple[Array, Agreement]:
        pose = self._map.register(sweep, twist, guess)
        structure = Structure(sweep.structure.compensated(twist))
        motion = compose(inverse(self._reference.world_from_ego), pose)
        is_young = self._map_sweeps < self._config.alignment.young_sweeps
        sigma_m = _NO_GUESS_M if is_young else self._config.alignment.registration_sigma_m
        motion = align_structure(
            self._reference.structure, structure, motion, self._config.agreement, sigma_m
        )
        pose = compose(self._reference.world_from_ego, motion)
        pose[:3, :3] = Rotation.from_matrix(pose[:3, :3]).as_matrix()  # rounding errors would add up
        return pose, measure_agreement(self._reference.structure, structure, motion, self._config.agreement)

    def _search(
        self, sweep: PreparedSweep, twist: Floats, predicted: Array, seconds: float
    ) -> Iterator[Array]:
        """Yield guesses of the pose around the predicted one, as far as a car can have gone."""
        last = self._reference.world_from_ego
        motions = search_motion(
            self._reference.structure.xyz_m,
            sweep.structure.compensated(twist),
            compose(inverse(last), predicted),
            self._reach(seconds),
            self._config.search,
        )
        return (compose(last, motion) for motion in motions)

    def _reach(self, seconds: float) -> Reach:
        placement = self._config.placement
        return Reach(
            placement.tolerance_m + placement.max_acceleration_mps2 * seconds**2,
            placement.tolerance_rad + placement.max_yaw_acceleration_radps2 * seconds**2,
        )

    def _is_possible(self, predicted: Array, pose: Array, seconds: float) -> bool:
        reach, deviation = self._reach(seconds), compose(inverse(predicted), pose)
        is_near = np.linalg.norm(deviation[:3, 3]) <= reach.shift_m
        return bool(is_near and abs(yaw_of(deviation)) <= reach.turn_rad)

    def _is_usual(self, predicted: Array, pose: Array, agreement: Agreement, seconds: float) -> bool:
        if not self._is_possible(predicted, pose, seconds) or not self._fits(agreement):
            return False
        if not self._shares:
            return True
        usual = self._config.placement.usual_share * float(np.median(self._shares))
        return not agreement.is_measured or agreement.inlier_share >= usual

    def _fits(self, agreement: Agreement) -> bool:
        # Where nothing was upright all along, nothing can be judged.
        return is_believed(agreement, self._config) and (agreement.is_measured or not self._shares)

    def _place(
        self, sweep: PreparedSweep, predicted: Array, pose: Array, agreement: Agreement, *, is_bridged: bool
    ) -> Placement:
        last_s, last = self._poses[-1]
        self._twist = velocity_between(last, pose, sweep.time_s - last_s)
        self._steps_s.append(sweep.time_s - last_s)
        if agreement.is_measured:
            self._shares.append(agreement.inlier_share)
        if not is_bridged:
            self._map.learn_deviation(predicted, pose)
        reference_s = self._reference.time_s
        self._commit(sweep, pose)
        return Placement(sweep.time_s, pose, self._twist, True, is_bridged, agreement, reference_s)

    def _commit(self, sweep: PreparedSweep, pose: Array) -> None:
        self._map_sweeps += 1
        self._map.add(sweep, self._twist, pose)
        self._refer_to(Reference(sweep.time_s, pose, Structure(sweep.structure.compensated(self._twist))))
        self._poses.append((sweep.time_s, pose))
        while len(self._poses) > 2 and self._poses[1][0] < sweep.time_s - _BASELINE_S:
            self._poses.popleft()

    def _refer_to(self, reference: Reference) -> None:
        """Judge the next sweeps by this one, unless it saw far less than the one before: behind a lorry, say."""
        self._sizes.append(len(reference.structure))
        is_poor = len(reference.structure) < _POOR * float(np.median(self._sizes))
        if is_poor and reference.time_s - self._reference.time_s < self._config.placement.give_up_s:
            return
        if len(self._sizes) > 1 and self._is_beside(reference):
            return
        self._reference = reference

    def _is_beside(self, reference: Reference) -> bool:
        """Whether the car has hardly moved since the reference: steps against one sweep do not drift."""
        alignment = self._config.alignment
        moved = compose(inverse(self._reference.world_from_ego), reference.world_from_ego)
        return bool(
            np.linalg.norm(moved[:3, 3]) < alignment.reference_m
            and abs(yaw_of(moved)) < alignment.reference_rad
            and reference.time_s - self._reference.time_s < alignment.reference_s
        )


def is_believed(agreement: Agreement, config: LidarOdometryConfig) -> bool:
    """Whether sweeps agree well enough, as far as upright things tell."""
    return not agreement.is_measured or agreement.inlier_share >= config.placement.min_inlier_share
