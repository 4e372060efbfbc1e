"""People who walk close together, told apart."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.types import Array, Floats, Ints

VOXEL_M = 0.05
MIN_POINTS = 3  # in a neighbourhood: arms are thin
THIN_M = 0.2  # narrower is a stripe of a surface that is only sampled so sparsely
BROAD_M = 1.2  # a person with a stride
TALL_M = (0.8, 2.2)
MEMBERS = 0.9  # share of the points that the persons must hold together


def split_crowd(xyz_m: Floats, *, gap_m: float) -> Ints:
    """(n,) number of the person that each point belongs to; all 0 where these are not several persons.

    Seen from above, persons are patches with gaps between them. A car falls apart too, into panels
    between windows, but its pieces are flatter or longer than persons.

    Args:
        xyz_m: (n, 3) points of one cluster, not those on the ground.
        gap_m: Persons are at least this far from each other.
    """
    together = np.zeros(len(xyz_m), dtype=np.int64)
    piece = dbscan_voxels(xyz_m[:, :2], eps_m=gap_m, min_points=MIN_POINTS, voxel_m=VOXEL_M)
    sizes = range(piece.max(initial=NOISE) + 1)
    persons = [number for number in sizes if _is_person(xyz_m[piece == number])]
    if len(persons) < 2 or np.isin(piece, persons).mean() < MEMBERS:
        return together
    centres = np.array([xyz_m[piece == number, :2].mean(axis=0) for number in persons])
    nearest = np.linalg.norm(xyz_m[:, None, :2] - centres, axis=2).argmin(axis=1)
    number_of = np.full(piece.max() + 2, NOISE)  # the last entry is that of NOISE = -1
    number_of[persons] = np.arange(len(persons))
    return np.where(number_of[piece] == NOISE, nearest, number_of[piece])


def _is_person(xyz_m: Floats) -> bool:
    extent: Array = np.ptp(xyz_m, axis=0)
    broad, tall = float(extent[:2].max()), float(extent[2])
    return THIN_M <= broad <= min(BROAD_M, tall) and TALL_M[0] <= tall <= TALL_M[1]
