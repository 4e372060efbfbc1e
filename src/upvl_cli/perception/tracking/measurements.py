"""The boxes of a segment as a Kalman filter takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.tracking.motion_model import MotionModel
from upvl_cli.types import Array, Boxes, Floats, Ints


@dataclass(frozen=True)
class Measurements:
    """The boxes of a segment in world axes.

    Attributes:
        frame: (n,) number of the frame of each, ascending.
        boxes: n boxes.
        velocity_mps: (n, 3) velocities.
        state: (n, 4) x, y, vx, vy.
        noise: (n, 4, 4) covariance of each state.
        time_s: (T,) ascending time of each frame.
    """

    frame: Ints
    boxes: Boxes
    velocity_mps: Floats
    state: Floats
    noise: Floats
    time_s: Floats

    @classmethod
    def of_boxes(
        cls, model: MotionModel, frame: Ints, boxes: Boxes, velocity_mps: Floats, time_s: Floats
    ) -> Measurements:
        """Return the measurements with the noise of a model; arguments as the attributes."""
        state = np.hstack([boxes.center_m[:, :2], velocity_mps[:, :2]])
        return cls(frame, boxes, velocity_mps, state, model.noise(boxes), time_s)

    def time_of(self, row: Ints | int) -> Array:
        """Return the times of some of the boxes."""
        return np.asarray(self.time_s[self.frame[row]])

    def smooth(self, model: MotionModel, tracks: list[Ints]) -> list[tuple[Array, Array]]:
        """Return the states and covariances of each track in all frames from its first to its last.

        Args:
            model: How objects move.
            tracks: The boxes of each track, ascending.
        """
        time_s, measured, noises = [], [], []
        for rows in tracks:
            frame = self.frame[rows]
            first, last = frame[0], frame[-1]
            state, noise = np.full((last - first + 1, 4), np.nan), np.zeros((last - first + 1, 4, 4))
            state[frame - first], noise[frame - first] = self.state[rows], self.noise[rows]
            time_s.append(self.time_s[first : last + 1])
            measured.append(state)
            noises.append(noise)
        return model.filter_tracks(time_s, measured, noises)
