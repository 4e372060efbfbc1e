"""Split of a cluster of persons who walk close together."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.proposals.config import CrowdConfig
from upvl_cli.types import Floats, Ints


def split_crowd(xyz_m: Floats, config: CrowdConfig) -> Ints:
    """Return (n,) number of the person that each point belongs to; all 0 where these are not several persons.

    Seen from above, persons are patches with gaps between them. A car falls apart too, into panels
    between windows, but its pieces are flatter or longer than persons.

    Args:
        xyz_m: (n, 3) points of one cluster, z up, without those on the ground.
        config: Gap between persons, and their size.
    """
    one_object = np.zeros(len(xyz_m), dtype=np.int64)
    patch = dbscan_voxels(
        xyz_m[:, :2], eps_m=config.gap_m, min_points=config.min_points, voxel_m=config.voxel_m
    )
    persons = [
        number for number in range(patch.max(initial=NOISE) + 1) if _is_person(xyz_m[patch == number], config)
    ]
    if len(persons) < 2 or np.isin(patch, persons).mean() < config.min_share:
        return one_object
    centers = np.array([xyz_m[patch == number, :2].mean(axis=0) for number in persons])
    nearest = np.linalg.norm(xyz_m[:, None, :2] - centers, axis=2).argmin(axis=1)
    person_of_patch = np.full(patch.max() + 2, NOISE)  # the last entry is that of NOISE = -1
    person_of_patch[persons] = np.arange(len(persons))
    return np.where(person_of_patch[patch] == NOISE, nearest, person_of_patch[patch])


def _is_person(xyz_m: Floats, config: CrowdConfig) -> bool:
    """Return whether the points have the size of a person, who is taller than wide."""
    width_m, height_m = float(np.ptp(xyz_m[:, :2], axis=0).max()), float(np.ptp(xyz_m[:, 2]))
    wide_as_person = config.min_width_m <= width_m <= min(config.max_width_m, height_m)
    return wide_as_person and config.min_height_m <= height_m <= config.max_height_m
