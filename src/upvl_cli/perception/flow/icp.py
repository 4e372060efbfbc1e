"""ICP of groups of points about the vertical, all groups together (Segal et al., Generalized-ICP, RSS 2009)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.small_matrices import solve_positive_definite
from upvl_cli.perception.flow.config import FlowIcpConfig
from upvl_cli.perception.flow.groups import Poses, apply_poses, rotate_about_z
from upvl_cli.perception.flow.surface import LocalSurface
from upvl_cli.types import Floats, Ints

RIDGE = 1e-6  # of the trace: leaves what no pair fixes (the turn of a pole) where it is
CONVERGED = 0.004  # metres plus radians: below the range noise, so a smaller step ends the search


def icp(
    surface: LocalSurface, tree: cKDTree, poses: Poses, radii_m: tuple[float, ...], config: FlowIcpConfig
) -> Poses:
    """Register each hypothesis with the other sweep: ICP about the vertical, from planar patch to point.

    A flat patch counts fully across, and by the tangential weight along itself: the scan lines of a surface
    lie elsewhere in each sweep and must not draw each other. It is Generalized-ICP with the covariance of one
    side only.

    Args:
        surface: Points to move, with the surface around them.
        tree: Points of the other sweep.
        poses: Starts.
        radii_m: Correspondence radius of each step.
        config: Weights.
    """
    yaw_rad, center_m = poses.yaw_rad.copy(), poses.center_m.copy()
    active = np.arange(len(poses.group))
    for radius_m in radii_m:
        if not len(active):
            break
        now = Poses(poses.group[active], yaw_rad[active], center_m[active])
        solved, yaw, shift = _step(surface, tree, now, (radius_m, radii_m[0]), config)
        moved = active[solved]
        yaw_rad[moved] += yaw
        center_m[moved] += shift
        change = np.abs(shift).max(axis=1, initial=0) + np.abs(yaw)
        active = moved[(change > CONVERGED) | (radius_m > radii_m[-1])]
    return Poses(poses.group, yaw_rad, center_m)


def _step(
    surface: LocalSurface, tree: cKDTree, poses: Poses, radii_m: tuple[float, float], config: FlowIcpConfig
) -> tuple[Ints, Floats, Floats]:
    """Return which hypotheses have enough pairs, and the turn and shift that bring these closer.

    Args:
        surface: Points to move, with the surface around them.
        tree: Points of the other sweep.
        poses: h hypotheses.
        radii_m: Correspondence radius, and the widest one where points lie far apart.
        config: Weights.
    """
    item, point, xyz_m = apply_poses(surface.groups, poses)
    radius_m, widest_m = radii_m
    # Where points lie far apart, so do partners.
    reach_m = np.clip(config.radius_spacings * surface.spacing_m[point], radius_m, max(radius_m, widest_m))
    distance, partner = tree.query(xyz_m, distance_upper_bound=reach_m.max(initial=radius_m))
    paired = distance < reach_m
    item, point, xyz_m = item[paired], point[paired], xyz_m[paired]
    residual_m = tree.data[partner[paired]] - xyz_m
    count = np.bincount(item, minlength=len(poses.group))
    system = _normal_equations(
        surface, point, poses, xyz_m - poses.center_m[item], residual_m, item, config.tangential_weight
    )
    rise_m = poses.center_m[:, 2] - surface.groups.center_m[poses.group, 2]
    system[:, 3, 3] += config.level_weight * count
    system[:, 3, 4] -= config.level_weight * count * rise_m
    solved = np.flatnonzero(count >= config.min_pairs)
    system = system[solved]
    ridge = RIDGE * np.trace(system[:, :, :4], axis1=1, axis2=2)[:, None, None] * np.eye(4)
    step = solve_positive_definite(system[:, :, :4] + ridge, system[:, :, 4:])[..., 0]
    return solved, step[:, 0], step[:, 1:]


def _normal_equations(
    surface: LocalSurface,
    point: Ints,
    poses: Poses,
    arm_m: Floats,
    residual_m: Floats,
    item: Ints,
    tangential_weight: float,
) -> Floats:
    """Return (h, 4, 5) normal equations of turn, x, y and z with their right sides.

    Args:
        surface: Points with the surface around them.
        point: (n,) the points that have a partner.
        poses: h hypotheses.
        arm_m: (n, 3) from the center of its hypothesis to each point.
        residual_m: (n, 3) from each point to its partner.
        item: (n,) the hypothesis of each point.
        tangential_weight: Weight of a flat patch along itself.
    """
    (ax, ay, _), (rx, ry, rz) = arm_m.T, residual_m.T
    nx, ny, nz = rotate_about_z(poses.yaw_rad[item], surface.normal[point]).T
    is_flat = surface.is_flat[point]
    isotropic, across = (
        np.where(is_flat, tangential_weight, 1.0),
        np.where(is_flat, 1 - tangential_weight, 0.0),
    )
    # Jacobian of the residual across the patch (turn, x, y, z) and that residual; products of the full ones.
    normal_part = (ax * ny - ay * nx, nx, ny, nz, nx * rx + ny * ry + nz * rz)
    full = {
        (0, 0): ax * ax + ay * ay, (0, 1): -ay, (0, 2): ax, (0, 4): ax * ry - ay * rx,
        (1, 1): 1.0, (2, 2): 1.0, (3, 3): 1.0, (1, 4): rx, (2, 4): ry, (3, 4): rz,
    }  # fmt: skip
    system = np.zeros((len(poses.group), 5, 5))
    for i in range(4):
        for j in range(i, 5):
            product = across * normal_part[i] * normal_part[j] + isotropic * full.get((i, j), 0.0)
            system[:, i, j] = system[:, j, i] = np.bincount(item, product, len(poses.group))
    return system[:, :4]
