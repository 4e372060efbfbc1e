"""Things that move beside what does not: parts of components that the motion of the whole leaves unexplained."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.clustering import dbscan_voxels
from upvl_cli.algorithms.flow_groups import Poses, centres, renumbered, sample, still, turned
from upvl_cli.algorithms.flow_motion import nearest_m
from upvl_cli.algorithms.flow_pair import REFINE, Pair, likeliest, seen
from upvl_cli.algorithms.flow_surface import NOISE_M, Surface, misfit, surface, tree_of
from upvl_cli.algorithms.voxels import voxelize
from upvl_cli.types import Bools, Floats, Ints

PATCH_M = 0.5  # edge of the cubes that are asked whether they are where they should be
PATCH = 6  # points of a cube that answer
NEAR_RAD = 0.003  # of the range: no LiDAR's spacing is finer, so what lies nearer need not be looked at
MOST_POINTS = 3000  # of a component: a street front has more, and takes longer than all the rest
MIN_POINTS = 30  # of a part: edges of shadows leave fewer


def move_parts(
    pair: Pair, of_source: Ints, of_target: Ints, *, eps_m: float, min_points: int, voxel_m: float
) -> None:
    """Look again at components with unexplained patches, in pieces half as far apart.

    A piece whose unexplained points have a motion takes it, whole if the rest of it fits as well; one
    without that lies better at rest than where its component's motion puts it comes to rest.

    Args:
        pair: The sweeps, and their motion so far, which is written to.
        of_source: (n,) component of each point of the first sweep, -1 for none.
        of_target: (m,) the same for the second.
        eps_m: Points closer than this are one piece, in both sweeps together.
        min_points: Points that make a neighbourhood dense.
        voxel_m: Points closer than this count as one place when pieces are made.
    """
    size = np.bincount(of_source[of_source >= 0], minlength=int(of_source.max(initial=-1)) + 1)
    of_source = renumbered(of_source, np.flatnonzero(size <= MOST_POINTS))
    of_target = renumbered(of_target, np.flatnonzero(size <= MOST_POINTS))
    stirred = (of_source >= 0) & unexplained(
        pair.source_m, pair.shift_m, pair.yaw_rad, of_source, pair.tree, pair.still_misfit
    )
    opened = np.flatnonzero(np.bincount(of_source[stirred]) >= MIN_POINTS)
    source, target = (np.flatnonzero(np.isin(of, opened)) for of in (of_source, of_target))
    if not len(source) or not len(target):
        return
    target_m = pair.target_m[target]
    at_rest = np.zeros((len(target), 3))
    free = unexplained(
        target_m,
        at_rest,
        at_rest[:, 0],
        of_target[target],
        tree_of(pair.source_m + pair.shift_m),
        pair.still_misfit,
    )
    piece = dbscan_voxels(
        np.concatenate([pair.source_m[source], target_m]),
        eps_m=eps_m / 2,
        min_points=min_points,
        voxel_m=voxel_m / 2,
    )
    active = stirred[source] | (pair.shift_m[source] != 0).any(axis=1)
    of, of_free = np.split(piece, [len(source)])
    count = np.bincount(of[active & (of >= 0)], minlength=piece.max(initial=-1) + 1)
    kept = np.flatnonzero(count >= MIN_POINTS)
    if not len(kept) or not free.any():
        return
    of, of_free = renumbered(of, kept), renumbered(of_free, kept)
    _decide(pair, source, of, np.where(active, of, -1), target_m[free], of_free[free], len(kept))


def _decide(
    pair: Pair, source: Ints, whole: Ints, part: Ints, free_m: Floats, of_free: Ints, total: int
) -> None:
    """Give each piece, or its active part, its motion.

    Args:
        pair: The sweeps.
        source: (k,) points of the first sweep.
        whole: (k,) piece of each, -1 for none.
        part: (k,) the same, -1 for those which are explained, too.
        free_m: (m, 3) points of the second sweep that pieces may have become.
        of_free: (m,) piece that each lies close to.
        total: How many pieces there are.
    """
    xyz_m = pair.source_m[source]
    points, poses, after = likeliest(pair, xyz_m, part, free_m, of_free, total)
    rest, so_far = _misfits(pair, source, part, points)
    # Beside other things it is easier to find something that fits by chance: the gain must come twice.
    moves = (rest > pair.still_misfit) & (after < (1 - pair.min_gain) ** 2 * np.minimum(rest, so_far))
    every = seen(xyz_m, whole, total, REFINE)
    rest, so_far = _misfits(pair, source, whole, every)
    arm_m = every.groups.centre_m - points.groups.centre_m
    place_m = poses.place_m + turned(poses.yaw_rad, arm_m)
    together = Poses(poses.group, poses.yaw_rad, place_m)
    all_move = moves & (misfit(every, pair.tree, together) <= np.minimum(rest, so_far))
    pair.move(source, whole, ~moves & (rest < so_far), every.groups, still(every.groups))
    pair.move(source, part, moves & ~all_move, points.groups, poses)
    pair.move(source, whole, all_move, every.groups, together)


def _misfits(pair: Pair, source: Ints, group: Ints, points: Surface) -> tuple[Floats, Floats]:
    """Misfit of each group at rest, and by the motion so far."""
    held = group >= 0
    so_far = pair.poses(source[held], group[held], points.groups)
    return misfit(points, pair.tree, still(points.groups)), misfit(points, pair.tree, so_far)


def unexplained(
    xyz_m: Floats, shift_m: Floats, yaw_rad: Floats, label: Ints, tree: cKDTree, still_misfit: float
) -> Bools:
    """(n,) which points lie in small patches that do not lie on the other sweep.

    Args:
        xyz_m: (n, 3) points.
        shift_m: (n, 3) how far each has moved.
        yaw_rad: (n,) how far each has turned.
        label: (n,) points of different labels share no patch.
        tree: Points of the other sweep.
        still_misfit: Patches farther from it, in spacings, are unexplained.
    """
    patch = voxelize(np.column_stack([xyz_m, (label + 0.5) * PATCH_M]), voxel_m=PATCH_M).of_point
    total = int(patch.max(initial=-1)) + 1
    groups = sample(xyz_m, patch, total=total, most=PATCH)
    motion = centres(np.column_stack([shift_m, yaw_rad]), patch, total)
    poses = Poses(np.arange(total), motion[:, 3], groups.centre_m + motion[:, :3])
    near_m = still_misfit * (NOISE_M + NEAR_RAD * np.linalg.norm(groups.centre_m, axis=1))
    far = np.flatnonzero(nearest_m(groups, tree, poses) > near_m)
    patch = renumbered(patch, far)
    around_m = xyz_m[np.isin(label, label[patch >= 0])]
    points = surface(sample(xyz_m, patch, total=len(far), most=PATCH), around_m)
    poses = Poses(np.arange(len(far)), poses.yaw_rad[far], poses.place_m[far])
    return np.append(misfit(points, tree, poses) > still_misfit, False)[patch]
