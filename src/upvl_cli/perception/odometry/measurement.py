"""Measurement of poses by the sweeps: how well each sweep agrees with the one before under them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.odometry.agreement import Agreement, Structure, measure_agreement
from upvl_cli.perception.odometry.config import AgreementConfig
from upvl_cli.perception.odometry.constant_velocity import velocity_between
from upvl_cli.perception.odometry.sweep import Cloud
from upvl_cli.perception.odometry.trajectory import EstimatedPath
from upvl_cli.types import Array, Floats


def measure_poses(
    structures: Iterable[Cloud], poses: Array, time_s: Floats, config: AgreementConfig
) -> Iterator[Agreement | None]:
    """Yield how well each sweep agrees with the one before under given poses; None for the first.

    Args:
        structures: The upright points of each sweep; one is held at a time.
        poses: (T, 4, 4) world_from_ego.
        time_s: (T,) their times.
        config: How agreement is measured.
    """
    velocities = path_velocities(poses, time_s)
    before: Structure | None = None
    for step, cloud in enumerate(structures):
        here = Structure(cloud.compensated(velocities[step]))
        if before is None:
            yield None
        else:
            motion = compose(inverse(poses[step - 1]), poses[step])
            yield measure_agreement(before, here, motion, config)
        before = here


def path_velocities(poses: Array, time_s: Floats) -> Floats:
    """Return the (T, 6) velocity (m/s, rad/s) at each pose: from the one before to the one after.

    Args:
        poses: (T, 4, 4) world_from_ego.
        time_s: (T,) their times.
    """
    total = len(poses)
    velocities = np.zeros((total, 6))
    for step in range(total if total > 1 else 0):
        first, last = max(step - 1, 0), min(step + 1, total - 1)
        velocities[step] = velocity_between(poses[first], poses[last], float(time_s[last] - time_s[first]))
    return velocities


def measure_trajectory(
    structures: Iterable[Cloud], poses: Array, time_s: Floats, config: AgreementConfig
) -> EstimatedPath:
    """Return given poses with how well the sweeps agree with them.

    Args:
        structures: The upright points of each sweep; one is held at a time.
        poses: (T, 4, 4) world_from_ego.
        time_s: (T,) their times.
        config: How agreement is measured.
    """
    agreements = list(measure_poses(structures, poses, time_s, config))
    sigmas = np.array([(0.0, 0.0) if each is None else each.sigmas for each in agreements])
    return EstimatedPath(
        world_from_ego=poses,
        is_placed=np.ones(len(poses), dtype=bool),
        is_bridged=np.zeros(len(poses), dtype=bool),
        residual_m=np.array([np.nan if each is None else each.rmse_m() for each in agreements]),
        inlier_share=np.array([np.nan if each is None else each.inlier_share for each in agreements]),
        position_sigma_m=sigmas.reshape(-1, 2)[:, 0],
        heading_sigma_rad=sigmas.reshape(-1, 2)[:, 1],
    )
