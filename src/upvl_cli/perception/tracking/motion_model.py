"""Motion of an object seen from above: nearly constant velocity, state x, y, vx, vy in world axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import predict, rts_smoother, update

from upvl_cli.types import Array, Floats

# A box shows the part that the sensor sees: its centre strays by about a tenth of its length.
CENTRE_SHARE = 0.1


@dataclass(frozen=True)
class MotionModel:
    """How objects move and how well they are seen.

    Attributes:
        agility_m2ps3: Spectral density of the acceleration: a velocity wanders by the root of this times
            the time, whatever the frame rate.
        position_noise_m: Standard deviation of the centre of a small box.
        velocity_noise_mps: Standard deviation of the velocity that comes with a box.
    """

    agility_m2ps3: float
    position_noise_m: float
    velocity_noise_mps: float

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """(4, 4) matrix that moves a state on by a time, and the noise that comes with it."""
        moves = np.eye(4)
        moves[0, 2] = moves[1, 3] = dt_s
        noise = Q_continuous_white_noise(
            dim=2, dt=dt_s, spectral_density=self.agility_m2ps3, block_size=2, order_by_dim=False
        )
        return moves, np.asarray(noise)

    def noise(self, seven: Floats) -> Array:
        """(n, 4, 4) measurement noise of boxes: wider along their longer side.

        Args:
            seven: (n, 7) boxes.
        """
        axes = np.stack([np.cos(seven[:, 6]), np.sin(seven[:, 6])], axis=1)
        axes = np.stack([axes, axes[:, ::-1] * [-1.0, 1.0]], axis=2)  # (n, 2, 2), a column an axis
        spread = self.position_noise_m**2 + (CENTRE_SHARE * seven[:, 3:5]) ** 2
        noise = np.zeros((len(seven), 4, 4))
        noise[:, :2, :2] = (axes * spread[:, None]) @ axes.transpose(0, 2, 1)
        noise[:, 2, 2] = noise[:, 3, 3] = self.velocity_noise_mps**2
        return noise

    def filter(self, time_s: Floats, measured: Floats, noise: Floats) -> tuple[Array, Array]:
        """(T, 4) states and (T, 4, 4) covariances of one object, each from all of its measurements.

        A Kalman filter runs forward and a Rauch-Tung-Striebel smoother runs back.

        Args:
            time_s: (T,) ascending times.
            measured: (T, 4) measurements, NaN in rows without one; the first row has one.
            noise: (T, 4, 4) their noise.
        """
        states, spreads = [measured[0]], [noise[0]]
        steps = [self.transition(dt_s) for dt_s in np.diff(time_s)]
        for (moves, drift), seen, blur in zip(steps, measured[1:], noise[1:], strict=True):
            state, spread = predict(states[-1], spreads[-1], moves, drift)
            if np.isfinite(seen).all():
                state, spread = update(state, spread, seen, blur, np.eye(4))
            states.append(state)
            spreads.append(spread)
        if not steps:
            return np.array(states), np.array(spreads)
        moves_all, drift_all = zip(*steps, strict=True)
        state, spread, _, _ = rts_smoother(np.array(states), np.array(spreads), moves_all, drift_all)
        return state, spread


def squared_distance(offset: Floats, spread: Floats) -> Array:
    """Squared Mahalanobis distance of each offset.

    Args:
        offset: (..., d) differences.
        spread: (..., d, d) covariance of each.
    """
    return np.asarray((offset * np.linalg.solve(spread, offset[..., None])[..., 0]).sum(axis=-1))
