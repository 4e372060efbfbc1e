"""Motion of an object seen from above: nearly constant velocity, state x, y, vx, vy in world axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.small_matrices import product, solve_positive_definite, transposed
from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.types import Array, Boxes, Floats


@dataclass(frozen=True)
class MotionModel:
    """How objects move and how well they are seen.

    Attributes:
        config: Settings: the acceleration's spectral density makes a velocity wander by the root of this times the
            time, whatever the frame rate.
    """

    config: TrackerConfig

    def transition(self, dt_s: float | Floats) -> tuple[Array, Array]:
        """Return the (..., 4, 4) matrices that move a state on by a time, and the process noise of that time.

        Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section
        6.2.2: the acceleration is white noise.

        Args:
            dt_s: (...) times.
        """
        dt_s = np.asarray(dt_s, dtype=np.float64)
        transition, noise = np.zeros((*dt_s.shape, 4, 4)), np.zeros((*dt_s.shape, 4, 4))
        transition[..., range(4), range(4)] = 1.0
        for position, velocity in ((0, 2), (1, 3)):
            transition[..., position, velocity] = dt_s
            noise[..., position, position] = dt_s**3 / 3
            noise[..., position, velocity] = noise[..., velocity, position] = dt_s**2 / 2
            noise[..., velocity, velocity] = dt_s
        return transition, noise * self.config.acceleration_psd_m2ps3

    def noise(self, boxes: Boxes) -> Array:
        """Return the (n, 4, 4) measurement noise of boxes: wider along their longer side, of which a part is hidden."""
        cos, sin = np.cos(boxes.heading_rad), np.sin(boxes.heading_rad)
        axes = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=2)  # (n, 2, 2)
        share = self.config.center_noise_share * boxes.size_lwh_m[:, :2]
        variance = self.config.position_noise_m**2 + share**2
        noise = np.zeros((len(boxes), 4, 4))
        noise[:, :2, :2] = product(axes * variance[:, None], transposed(axes))
        noise[:, 2, 2] = noise[:, 3, 3] = self.config.velocity_noise_mps**2
        return noise

    def predict(self, state: Floats, covariance: Floats, dt_s: float | Floats) -> tuple[Array, Array]:
        """Return states and covariances a time later.

        Args:
            state: (..., 4) states.
            covariance: (..., 4, 4) covariance of each.
            dt_s: (...) times.
        """
        transition, noise = self.transition(dt_s)
        moved = product(transition, state[..., None])[..., 0]
        return moved, product(product(transition, covariance), transposed(transition)) + noise

    def filter(self, time_s: Floats, measured: Floats, noise: Floats) -> tuple[Array, Array]:
        """Return (T, 4) states and (T, 4, 4) covariances of one object, each from all of its measurements.

        Args:
            time_s: (T,) ascending times.
            measured: (T, 4) measurements, NaN in rows without one; the first row has one.
            noise: (T, 4, 4) their noise.
        """
        return self.filter_tracks([time_s], [measured], [noise])[0]

    def filter_tracks(
        self, time_s: Sequence[Floats], measured: Sequence[Floats], noise: Sequence[Floats]
    ) -> list[tuple[Array, Array]]:
        """Return states and covariances of many objects, each from all of its measurements.

        A Kalman filter runs forward and a Rauch-Tung-Striebel smoother runs back, for all objects at once.
        Rauch, Tung and Striebel, Maximum likelihood estimates of linear dynamic systems (1965).

        Args:
            time_s: For each object its (T,) ascending times.
            measured: (T, 4) measurements of each, NaN in rows without one; the first row has one.
            noise: (T, 4, 4) noise of each.

        Returns:
            (T, 4) states and (T, 4, 4) covariances of each object.
        """
        length = np.array([len(times) for times in time_s], dtype=np.int64)
        order = np.argsort(-length, kind="stable")  # the objects that last for some steps are the first ones
        start = np.cumsum(length) - length
        box, box_noise = (np.concatenate([*parts]) for parts in (measured, noise)) if len(order) else ((), ())
        dt_s = np.concatenate([np.append(0.0, np.diff(times)) for times in time_s]) if len(order) else ()
        states, covariances = np.array(box, dtype=np.float64), np.array(box_noise, dtype=np.float64)
        is_seen = np.asarray(np.isfinite(states).all(axis=-1))
        predicted, predicted_covariances = states.copy(), covariances.copy()
        alive = [start[order[: int((length > step).sum())]] + step for step in range(length.max(initial=0))]
        for rows in alive[1:]:
            moved = self.predict(states[rows - 1], covariances[rows - 1], dt_s[rows])
            predicted[rows], predicted_covariances[rows] = moved
            states[rows], covariances[rows] = moved
            seen = rows[is_seen[rows]]
            states[seen], covariances[seen] = update(
                predicted[seen], predicted_covariances[seen], box[seen], box_noise[seen]
            )
        for rows in alive[:0:-1]:  # those that have a state before
            before = rows - 1
            transition, _ = self.transition(dt_s[rows])
            ahead = product(transition, covariances[before])  # P F' transposed
            gain = transposed(solve_positive_definite(predicted_covariances[rows], ahead))
            innovation = states[rows] - predicted[rows]
            states[before] += product(gain, innovation[..., None])[..., 0]
            change = covariances[rows] - predicted_covariances[rows]
            covariances[before] += product(product(gain, change), transposed(gain))
        ends = np.cumsum(length).tolist()
        return [
            (states[begin:end], covariances[begin:end])
            for begin, end in zip(start.tolist(), ends, strict=True)
        ]


def update(state: Floats, covariance: Floats, measured: Floats, noise: Floats) -> tuple[Array, Array]:
    """Return states and covariances corrected by a measurement of the whole state, in Joseph's form.

    Args:
        state: (..., 4) predicted states.
        covariance: (..., 4, 4) covariance of each.
        measured: (..., 4) measurements.
        noise: (..., 4, 4) covariance of each measurement.
    """
    gain = transposed(solve_positive_definite(covariance + noise, covariance))
    corrected = state + product(gain, (measured - state)[..., None])[..., 0]
    rest = np.eye(4) - gain
    prior = product(product(rest, covariance), transposed(rest))
    return corrected, prior + product(product(gain, noise), transposed(gain))


def squared_distance(offset: Floats, covariance: Floats) -> Array:
    """Return the squared Mahalanobis distance of each offset.

    Args:
        offset: (..., d) differences.
        covariance: (..., d, d) covariance of each.
    """
    weighted = solve_positive_definite(covariance, offset[..., None])
    return product(offset[..., None, :], weighted)[..., 0, 0]
