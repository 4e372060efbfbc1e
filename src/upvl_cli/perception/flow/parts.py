"""Things that move beside what does not: parts of components that the motion of the whole leaves unexplained."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.flow.groups import Poses, centres, renumbered, sample, still
from upvl_cli.perception.flow.motion import nearest_m
from upvl_cli.perception.flow.pair import Pair, likeliest
from upvl_cli.perception.flow.surface import NOISE_M, misfit, surface, tree_of
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats, Ints

PATCH_M = 0.7  # edge of the cubes that are asked whether they are where they should be
PATCH = 3  # points of a cube that answer
NEAR_RAD = 0.003  # of the range: no LiDAR's spacing is finer, so what lies nearer need not be looked at
MIN_POINTS = 40  # of a part: edges of shadows leave fewer


def move_parts(
    pair: Pair, of_source: Ints, of_target: Ints, *, eps_m: float, min_points: int, voxel_m: float
) -> None:
    """Look again at components with unexplained patches: at these, in pieces half as far apart.

    A piece that has a motion of its own takes it; one without that lies better at rest than where its
    component's motion puts it comes to rest.

    Args:
        pair: The sweeps, and their motion so far, which is written to.
        of_source: (n,) component of each point of the first sweep, -1 for none.
        of_target: (m,) the same for the second.
        eps_m: Points closer than this are one piece, in both sweeps together.
        min_points: Points that make a neighbourhood dense.
        voxel_m: Points closer than this count as one place when pieces are made.
    """
    motion = np.column_stack([pair.shift_m, pair.yaw_rad])
    stirred = (of_source >= 0) & unexplained(
        pair.source_m, motion, of_source, pair.source_tree, pair.tree, pair.still_misfit
    )
    opened = np.flatnonzero(np.bincount(of_source[stirred]) >= MIN_POINTS)
    source, target = (np.flatnonzero(np.isin(of, opened)) for of in (of_source, of_target))
    if not len(source) or not len(target):
        return
    target_m = pair.target_m[target]
    free = unexplained(
        target_m,
        np.zeros((len(target), 4)),
        of_target[target],
        pair.tree,
        tree_of(pair.source_m + pair.shift_m),
        pair.still_misfit,
    )
    active = (stirred | (pair.shift_m != 0).any(axis=1))[source]
    source, free_m = source[active], target_m[free]
    piece = dbscan_voxels(
        np.concatenate([pair.source_m[source], free_m]),
        eps_m=eps_m / 2,
        min_points=min_points,
        voxel_m=voxel_m / 2,
    )
    of, of_free = np.split(piece, [len(source)])
    kept = np.flatnonzero(np.bincount(of[of >= 0], minlength=piece.max(initial=-1) + 1) >= MIN_POINTS)
    if len(kept) and len(free_m):
        _decide(pair, source, renumbered(of, kept), free_m, renumbered(of_free, kept), len(kept))


def _decide(pair: Pair, source: Ints, of_source: Ints, free_m: Floats, of_free: Ints, total: int) -> None:
    """Give each piece its motion.

    Args:
        pair: The sweeps.
        source: (k,) points of the first sweep.
        of_source: (k,) piece of each, -1 for none.
        free_m: (m, 3) points of the second sweep that pieces may have become.
        of_free: (m,) piece that each lies close to.
        total: How many pieces there are.
    """
    points, poses, cost = likeliest(pair, source, of_source, free_m, of_free, total)
    held = of_source >= 0
    so_far = misfit(points, pair.tree, pair.poses(source[held], of_source[held], points.groups))
    rest = misfit(points, pair.tree, still(points.groups))
    # Beside other things it is easier to find something that fits by chance: the gain must come twice.
    moves = (rest > pair.still_misfit) & (cost < (1 - pair.min_gain) ** 2 * np.minimum(rest, so_far))
    lost = (so_far > pair.still_misfit) & (so_far > (1 - pair.min_gain) * rest)
    pair.move(source, of_source, ~moves & (lost | (rest < so_far)), points.groups, still(points.groups))
    pair.move(source, of_source, moves, points.groups, poses)


def unexplained(
    xyz_m: Floats, motion: Floats, label: Ints, own: cKDTree, other: cKDTree, still_misfit: float
) -> Bools:
    """(n,) which points lie in small patches that do not lie on the other sweep.

    Args:
        xyz_m: (n, 3) points.
        motion: (n, 4) how far each has moved, in metres, and turned.
        label: (n,) points of different labels share no patch.
        own: All points of the same sweep.
        other: Points of the other sweep.
        still_misfit: Patches farther from it, in spacings, are unexplained.
    """
    patch = voxelize(np.column_stack([xyz_m, (label + 0.5) * PATCH_M]), voxel_m=PATCH_M).of_point
    total = int(patch.max(initial=-1)) + 1
    groups = sample(xyz_m, patch, total=total, most=PATCH)
    motion = centres(motion, patch, total)
    poses = Poses(np.arange(total), motion[:, 3], groups.centre_m + motion[:, :3])
    near_m = still_misfit * (NOISE_M + NEAR_RAD * np.linalg.norm(groups.centre_m, axis=1))
    far = np.flatnonzero(nearest_m(groups, other, poses) > near_m)
    patch = renumbered(patch, far)
    points = surface(sample(xyz_m, patch, total=len(far), most=PATCH), own)
    poses = Poses(np.arange(len(far)), poses.yaw_rad[far], poses.place_m[far])
    return np.append(misfit(points, other, poses) > still_misfit, False)[patch]
