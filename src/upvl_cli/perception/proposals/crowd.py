"""Split of clusters of persons who walk close together."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.proposals.config import CrowdConfig
from upvl_cli.types import Array, Floats, Ints

# Clusters are searched for gaps all at once, so far apart that none meets another: more than any gap with a voxel.
# A power of two, so that the mean of equal values is that value.
_APART_M = 128.0


def split_crowds(xyz_m: Floats, cluster: Ints, config: CrowdConfig) -> Ints:
    """Return (n,) number of the person that each point belongs to; all 0 in a cluster that is not several persons.

    Seen from above, persons are patches with gaps between them. A car falls apart too, into panels
    between windows, but its pieces are flatter or longer than persons.

    Args:
        xyz_m: (n, 3) points, z up, without those on the ground.
        cluster: (n,) number of the cluster of each, from 0 on, ascending.
        config: Gap between persons, and their size.
    """
    person: Ints = np.zeros(len(xyz_m), dtype=np.int64)
    if not len(xyz_m):
        return person
    patch = dbscan_voxels(
        np.column_stack([xyz_m[:, :2], _APART_M * cluster]),
        eps_m=config.gap_m,
        min_points=config.min_points,
        voxel_m=config.voxel_m,
    )
    is_person = np.append(_are_persons(xyz_m, patch, config), False)  # the last entry is that of NOISE = -1
    of_patch = np.zeros(len(is_person), dtype=np.int64)
    of_patch[patch] = cluster
    total = int(cluster[-1]) + 1
    persons = np.bincount(of_patch[is_person], minlength=total)
    size = np.bincount(cluster, minlength=total)
    share = np.bincount(cluster[is_person[patch]], minlength=total) / np.maximum(size, 1)
    begin = np.cumsum(size) - size
    for crowd in np.flatnonzero((persons >= 2) & (share >= config.min_share)).tolist():
        points = slice(begin[crowd], begin[crowd] + size[crowd])
        person[points] = _nearest_persons(xyz_m[points], patch[points], is_person)
    return person


def _nearest_persons(xyz_m: Floats, patch: Ints, is_person: Array) -> Ints:
    """Return (n,) person of each point of a crowd: that of its patch, else the nearest one."""
    persons = np.unique(patch[is_person[patch]])
    centers = np.array([xyz_m[patch == number, :2].mean(axis=0) for number in persons])
    nearest = np.linalg.norm(xyz_m[:, None, :2] - centers, axis=2).argmin(axis=1)
    return np.where(is_person[patch], np.searchsorted(persons, patch), nearest)


def _are_persons(xyz_m: Floats, patch: Ints, config: CrowdConfig) -> Array:
    """Return (k,) whether the points of each patch have the size of a person, who is taller than wide."""
    order = np.argsort(patch, kind="stable")
    order = order[np.searchsorted(patch[order], 0) :]
    if not len(order):
        return np.zeros(0, dtype=np.bool_)
    first = np.searchsorted(patch[order], np.arange(patch[order[-1]] + 1))
    ordered = xyz_m[order]
    extent_m = np.maximum.reduceat(ordered, first) - np.minimum.reduceat(ordered, first)
    width_m, height_m = extent_m[:, :2].max(axis=1), extent_m[:, 2]
    wide_as_person = (width_m >= config.min_width_m) & (width_m <= np.minimum(config.max_width_m, height_m))
    return np.asarray(wide_as_person & (height_m >= config.min_height_m) & (height_m <= config.max_height_m))
