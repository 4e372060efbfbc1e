"""Motion of points between two sweeps: one rigid motion for each connected component.

The order is NSFP++'s (MI-UP, Najibi et al., ECCV 2022, section 4.1): ground and ego motion are out
already, what stands still is taken out, the rest falls into components, each looks for itself in an
expanded box of the other sweep. In place of a network each component gets a rigid motion by ICP,
started from a vote over displacements: on real pairs that is both nearer the truth and faster.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.flow.groups import Groups, Poses, posed, renumbered, sample, still
from upvl_cli.perception.flow.motion import MIN_PAIRS, nearest_m
from upvl_cli.perception.flow.pair import Pair, likeliest
from upvl_cli.perception.flow.parts import move_parts
from upvl_cli.perception.flow.surface import NOISE_M, misfit, tree_of
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats, Ints

CLAIM_M = 0.5  # edge of the places that only one thing can be in
SCREEN = 32  # points of a component that tell whether it may have moved


def estimate(
    source_xyz_m: Floats,
    target_xyz_m: Floats,
    dt_s: float,
    *,
    max_speed_mps: float,
    eps_m: float,
    min_points: int,
    voxel_m: float,
    still_misfit: float,
    min_gain: float,
) -> Floats:
    """(n, 3) velocity of each source point over the ground, 0 where it stands still.

    Args:
        source_xyz_m: (n, 3) points above the ground.
        target_xyz_m: (m, 3) the same of the other sweep, in the axes of the source.
        dt_s: Time from source to target; negative when the target came before.
        max_speed_mps: A faster component is noise, and gets no motion.
        eps_m: Points closer than this are one component, in both sweeps together.
        min_points: Points that make a neighbourhood dense.
        voxel_m: Points closer than this count as one place when components are made.
        still_misfit: A component this close to the other sweep, in spacings of its points, stands still.
        min_gain: Motion must lower the misfit by this share.
    """
    total = len(source_xyz_m)
    if not total or not len(target_xyz_m):
        return np.zeros((total, 3))
    pair = Pair(
        source_xyz_m,
        target_xyz_m,
        tree_of(source_xyz_m),
        tree_of(target_xyz_m),
        np.zeros((total, 3)),
        np.zeros(total),
        max_speed_mps * abs(dt_s),
        still_misfit,
        min_gain,
    )
    both = np.concatenate([source_xyz_m, target_xyz_m])
    label = dbscan_voxels(both, eps_m=eps_m, min_points=min_points, voxel_m=voxel_m)
    of_source, of_target = np.split(label, [total])
    _move_components(pair, of_source, of_target)
    move_parts(pair, of_source, of_target, eps_m=eps_m, min_points=min_points, voxel_m=voxel_m)
    return pair.shift_m / dt_s


def _move_components(pair: Pair, of_source: Ints, of_target: Ints) -> None:
    """Give each component the motion that explains it better than standing still."""
    restless = _restless(pair, of_source)
    of_source = renumbered(of_source, restless)
    # What stands still is nothing that something else has become; noise may be.
    free = (of_target == NOISE) | (renumbered(of_target, restless) >= 0)
    if not len(restless) or not free.any():
        return
    of_free, everything = renumbered(of_target[free], restless), np.arange(len(of_source))
    points, poses, after = likeliest(pair, everything, of_source, pair.target_m[free], of_free, len(restless))
    before = misfit(points, pair.tree, still(points.groups))
    moves = (before > pair.still_misfit) & (after < (1 - pair.min_gain) * before)
    gain = np.bincount(of_source[of_source >= 0]) * (before - after)
    moves[moves] = _undisputed(points.groups, poses[moves], gain[moves])
    pair.move(everything, of_source, moves, points.groups, poses)


def _undisputed(groups: Groups, poses: Poses, gain: Floats) -> Bools:
    """Which of some motions lead to places of which at least half are not another's, which explains more."""
    item, _, place_m = posed(groups, poses)
    place = voxelize(place_m, voxel_m=CLAIM_M).of_point
    place, item = np.divmod(np.unique(place * len(gain) + item), max(len(gain), 1))
    highest = np.zeros(place.max(initial=-1) + 1)
    np.maximum.at(highest, place, gain[item])
    kept = np.bincount(item, gain[item] >= highest[place], len(gain))
    return np.asarray(2 * kept >= np.bincount(item, minlength=len(gain)))


def _restless(pair: Pair, of_source: Ints) -> Ints:
    """The components that do not lie on the other sweep, by a sample of their points."""
    total = int(of_source.max(initial=NOISE)) + 1
    groups = sample(pair.source_m, of_source, total=total, most=SCREEN)
    off = np.flatnonzero((groups.size >= MIN_PAIRS) & (nearest_m(groups, pair.tree, still(groups)) > NOISE_M))
    points = pair.seen(np.arange(len(of_source)), renumbered(of_source, off), len(off), SCREEN)
    return off[misfit(points, pair.tree, still(points.groups)) > pair.still_misfit]
