"""Motion of an object seen from above: nearly constant velocity, state x, y, vx, vy in world axes."""

from __future__ import annotations

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

        A Kalman filter runs forward and a Rauch-Tung-Striebel smoother runs back.

        Args:
            time_s: (T,) ascending times.
            measured: (T, 4) measurements, NaN in rows without one; the first row has one.
            noise: (T, 4, 4) their noise.
        """
        states, covariances = [measured[0]], [noise[0]]
        dt_s = np.diff(time_s)
        for step_s, box, box_noise in zip(dt_s, measured[1:], noise[1:], strict=True):
            state, covariance = self.predict(states[-1], covariances[-1], step_s)
            if np.isfinite(box).all():
                state, covariance = update(state, covariance, box, box_noise)
            states.append(state)
            covariances.append(covariance)
        return self.smooth(np.array(states), np.array(covariances), dt_s)

    def smooth(self, states: Floats, covariances: Floats, dt_s: Floats) -> tuple[Array, Array]:
        """Return the states and covariances of a filter, each corrected by those after it.

        Rauch, Tung and Striebel, Maximum likelihood estimates of linear dynamic systems (1965).

        Args:
            states: (T, 4) states of a Kalman filter.
            covariances: (T, 4, 4) covariance of each.
            dt_s: (T - 1,) time from each to the next.
        """
        smooth_states, smooth_covariances = states.copy(), covariances.copy()
        transition, _ = self.transition(dt_s)
        predicted, predicted_covariances = self.predict(states[:-1], covariances[:-1], dt_s)
        ahead = product(transition, covariances[:-1])  # P F' transposed
        gain = transposed(solve_positive_definite(predicted_covariances, ahead))
        for k in range(len(states) - 2, -1, -1):
            innovation = smooth_states[k + 1] - predicted[k]
            smooth_states[k] += product(gain[k], innovation[:, None])[:, 0]
            change = smooth_covariances[k + 1] - predicted_covariances[k]
            smooth_covariances[k] += product(product(gain[k], change), gain[k].T)
        return smooth_states, smooth_covariances


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
