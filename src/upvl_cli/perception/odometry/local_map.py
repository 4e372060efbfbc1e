"""The local map of KISS-ICP and the registration of a sweep to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.odometry.config import KissIcpConfig
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.types import Array, Floats

if TYPE_CHECKING:
    from kiss_icp.config import KISSConfig

_MIN_DEVIATION_M = 0.1  # smaller deviations are noise, and say nothing of the motion (KISS-ICP's own value)
_KERNELS = 3.0  # correspondences reach so many thresholds (KISS-ICP, section III-C)


class LocalMap:
    """Points of the last sweeps around the car, and how far registrations were from what was predicted.

    KISS-ICP (Vizzo et al., "In Defense of Point-to-Point ICP", RA-L 2023), driven part by part.
    """

    def __init__(self, config: KissIcpConfig) -> None:
        """Begin with an empty map."""
        from kiss_icp.mapping import get_voxel_hash_map
        from kiss_icp.registration import get_registration

        kiss = _kiss_config(config)
        self._map, self._registration = get_voxel_hash_map(kiss), get_registration(kiss)
        self._max_range_m = config.max_range_m
        self._squares_m2, self._samples = config.initial_threshold_m**2, 1

    def register(self, sweep: PreparedSweep, twist: Floats, guess: Array) -> Array:
        """Return the (4, 4) pose of a sweep by ICP to the map.

        Args:
            sweep: The sweep.
            twist: (6,) velocity of the car, for the compensation of the motion during the sweep.
            guess: (4, 4) first guess of the pose.
        """
        threshold_m = float(np.sqrt(self._squares_m2 / self._samples))
        pose = self._registration.align_points_to_map(
            points=sweep.source.compensated(twist),
            voxel_map=self._map,
            initial_guess=guess,
            max_correspondance_distance=_KERNELS * threshold_m,
            kernel=threshold_m,
        )
        return np.asarray(pose)

    def add(self, sweep: PreparedSweep, twist: Floats, pose: Array) -> None:
        """Add the points of a placed sweep, and forget what is out of range."""
        self._map.update(sweep.map_points.compensated(twist), pose)

    def learn_deviation(self, predicted: Array, pose: Array) -> None:
        """Adapt the threshold of the next registrations (KISS-ICP, section III-C)."""
        deviation = compose(inverse(predicted), pose)
        cos = np.clip((np.trace(deviation[:3, :3]) - 1) / 2, -1, 1)
        deviation_m = float(
            2 * self._max_range_m * np.sin(np.arccos(cos) / 2) + np.linalg.norm(deviation[:3, 3])
        )
        if deviation_m > _MIN_DEVIATION_M:
            self._squares_m2, self._samples = self._squares_m2 + deviation_m**2, self._samples + 1


def _kiss_config(config: KissIcpConfig) -> KISSConfig:
    from kiss_icp.config import KISSConfig

    kiss = KISSConfig()
    kiss.data.max_range = config.max_range_m
    kiss.mapping.voxel_size = config.voxel_m
    kiss.registration.convergence_criterion = config.convergence_m
    # One thread: sums over several come in another order each time, and with them other last digits.
    kiss.registration.max_num_threads = 1
    return kiss
