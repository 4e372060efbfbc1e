"""Casts rays at a made-up street: the nearest surface on each, by the equations of the solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.types import Array, Ints, ParallelArrays, array
from world.scene import BOX, CYLINDER, MATERIAL_NUMBER, Ground, Solids


@dataclass(frozen=True)
class Hits(ParallelArrays):
    """What each ray meets first.

    Attributes:
        range_m: (n,) distance along the ray; infinite where it meets nothing.
        normal: (n, 3) direction that the surface looks to, in world axes.
        material: (n,) place in the list of `MATERIALS`; -1 for nothing.
        solid: (n,) number of the solid; -1 for the ground and for nothing.
    """

    range_m: Array = array("float64")
    normal: Array = array("float64", 3)
    material: Array = array("int64")
    solid: Array = array("int64")


def cast(origin_m: Array, rays: Array, solids: Solids, ground: Ground, *, reach_m: float) -> Hits:
    """Return the first surface on each ray.

    Args:
        origin_m: (3,) where all rays start, in world axes; above the ground and outside every solid.
        rays: (n, 3) their directions, of length 1.
        solids: What stands on the ground.
        ground: The ground.
        reach_m: A surface further away is not met.
    """
    columns = np.ascontiguousarray(rays.T)  # (3, n): numpy is fastest along the last axis
    ground_m, strip = _ground_range(origin_m, columns, ground, reach_m)
    solid_m, solid = _solid_range(origin_m, columns, solids, np.minimum(ground_m, reach_m))
    on_solid = np.flatnonzero(solid >= 0)
    on_ground = np.flatnonzero((solid < 0) & (strip >= 0))
    normal, material = np.zeros((len(rays), 3)), np.full(len(rays), -1)
    normal[on_ground] = _ground_normals(ground)[strip[on_ground]]
    material[on_ground] = np.array([MATERIAL_NUMBER[name] for name in ground.materials])[strip[on_ground]]
    at_m = origin_m + rays[on_solid] * solid_m[on_solid, None]
    normal[on_solid] = _solid_normals(at_m, solids[solid[on_solid]])
    material[on_solid] = solids.material[solid[on_solid]]
    return Hits(
        range_m=np.where(solid >= 0, solid_m, ground_m), normal=normal, material=material, solid=solid
    )


def _ground_range(origin_m: Array, rays: Array, ground: Ground, reach_m: float) -> tuple[Array, Ints]:
    """Return how far the ground is on each of the (3, n) rays, and the number of its strip (-1 for none)."""
    range_m, strip = np.full(rays.shape[1], np.inf), np.full(rays.shape[1], -1)
    y_m, slope = np.array(ground.y_m), np.diff(ground.z_m) / np.diff(ground.y_m)
    steep = rays[2] - ground.grade * rays[0]
    level_m = origin_m[2] - ground.grade * origin_m[0]
    for i in range(len(slope)):
        # The plane of strip i: z = z_i + slope (y - y_i) + grade x.
        above_m = level_m - ground.z_m[i] - slope[i] * (origin_m[1] - y_m[i])
        with np.errstate(divide="ignore", invalid="ignore"):
            found_m = -above_m / (steep - slope[i] * rays[1])
            at_y_m = origin_m[1] + found_m * rays[1]
        met = (found_m > 0) & (found_m < np.minimum(range_m, reach_m))
        met &= (at_y_m >= y_m[i]) & (at_y_m <= y_m[i + 1])
        range_m[met], strip[met] = found_m[met], i
    return range_m, strip


def _ground_normals(ground: Ground) -> Array:
    """Return the (k, 3) upward directions of the strips."""
    slope = np.diff(ground.z_m) / np.diff(ground.y_m)
    upward = np.stack([np.full_like(slope, -ground.grade), -slope, np.ones_like(slope)], axis=-1)
    return np.asarray(upward / np.linalg.norm(upward, axis=-1, keepdims=True))


def _solid_range(origin_m: Array, rays: Array, solids: Solids, limit_m: Array) -> tuple[Array, Ints]:
    """Return how far the first solid is on each of the (3, n) rays, and its number (-1 for none).

    Args:
        origin_m: (3,) start of the rays.
        rays: (3, n) directions.
        solids: What stands there.
        limit_m: (n,) a solid further away is not met.
    """
    range_m, solid = limit_m.copy(), np.full(rays.shape[1], -1)
    offset_m = solids.centre_m - origin_m
    first = np.flatnonzero(np.diff(solids.thing, prepend=-1))
    ball_m, radius_m = _balls(offset_m, np.linalg.norm(solids.half_m, axis=1), first)
    free_m = np.linalg.norm(ball_m, axis=1) - radius_m
    last = np.append(first[1:], len(solids))
    # From near to far, so that rays which already ended are spared the things behind.
    for k in np.argsort(free_m, kind="stable"):
        near = _rays_near(rays, ball_m[k], float(radius_m[k]))
        near = near[range_m.take(near) > free_m[k]]
        if not len(near):
            continue
        turned = _turned(rays.take(near, axis=1), -solids.heading_rad[first[k]])
        for i in range(first[k], last[k]):
            start_m = _turned(-offset_m[i], -solids.heading_rad[i])
            found_m = _enter_range(
                start_m / solids.half_m[i], turned / solids.half_m[i, :, None], solids.form[i]
            )
            closer = found_m < range_m.take(near)
            range_m[near[closer]], solid[near[closer]] = found_m[closer], i
    return range_m, solid


def _balls(centre_m: Array, radius_m: Array, first: Ints) -> tuple[Array, Array]:
    """Return (k, 3) centres and (k,) radii of balls around groups of smaller balls.

    Args:
        centre_m: (n, 3) centres of the small balls.
        radius_m: (n,) their radii.
        first: (k,) where each group begins.
    """
    low = np.minimum.reduceat(centre_m, first)
    middle = (low + np.maximum.reduceat(centre_m, first)) / 2
    group = np.searchsorted(first, np.arange(len(centre_m)), side="right") - 1
    outer_m = np.linalg.norm(centre_m - middle[group], axis=1) + radius_m
    return middle, np.maximum.reduceat(outer_m, first)


def _rays_near(rays: Array, offset_m: Array, radius_m: float) -> Ints:
    """Return the numbers of those (3, n) rays that can meet a ball at that offset, and a few more."""
    distance_m = float(np.linalg.norm(offset_m))
    if distance_m <= radius_m:
        return np.arange(rays.shape[1])
    tangent_m = float(np.sqrt(distance_m**2 - radius_m**2))
    return np.flatnonzero(offset_m @ rays > tangent_m * (1 - 1e-9))


def _turned(vectors: Array, angle_rad: float | Array) -> Array:
    """Return (3, ...) vectors turned counter-clockwise about the vertical."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vectors
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _enter_range(start: Array, rays: Array, form: int) -> Array:
    """Return (n,) how far a solid is on each ray, infinite where it is not met.

    Args:
        start: (3,) where the rays start, from the centre of the solid, in its axes and half sizes.
        rays: (3, n) directions in the same axes.
        form: BOX, CYLINDER or ELLIPSOID.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if form == BOX:
            enter, leave = _slab(start, rays)
        elif form == CYLINDER:
            # NaN, from a ray that passes by the round side, must win over the number of the flat side.
            enter, leave = np.array([_slab(start[2:], rays[2:]), _ball(start[:2], rays[:2])]).swapaxes(0, 1)
            enter, leave = enter.max(axis=0), leave.min(axis=0)
        else:
            enter, leave = _ball(start, rays)
        return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def _slab(start: Array, rays: Array) -> tuple[Array, Array]:
    """Return where rays enter and leave the cube of half size 1, in any number of dimensions."""
    one, other = (-1 - start[:, None]) / rays, (1 - start[:, None]) / rays
    return np.fmin(one, other).max(axis=0), np.fmax(one, other).min(axis=0)


def _ball(start: Array, rays: Array) -> tuple[Array, Array]:
    """Return where rays enter and leave the ball of radius 1; NaN where they pass it by."""
    a, b = (rays**2).sum(axis=0), (rays * start[:, None]).sum(axis=0)
    a = np.maximum(a, 1e-300)  # a ray along the axis of a cylinder stays inside for ever, or outside
    root = np.sqrt(b**2 - a * ((start**2).sum() - 1))
    return (-b - root) / a, (-b + root) / a


def _solid_normals(at_m: Array, solids: Solids) -> Array:
    """Return the (n, 3) outward directions at points of the surface of one solid each, in world axes."""
    local = _turned((at_m - solids.centre_m).T, -solids.heading_rad).T / solids.half_m
    upright = solids.form == CYLINDER
    # A box shows the face whose coordinate is 1; a cylinder its roof or floor where z is.
    face = np.where(upright, 2, np.abs(local).argmax(axis=1))
    flat = (solids.form == BOX) | (upright & (np.abs(local[:, 2]) > 1 - 1e-9))
    outward = np.where(upright[:, None], local * [1.0, 1.0, 0.0], local)
    outward[flat] = (np.eye(3)[face] * np.sign(local))[flat]
    outward = _turned((outward / solids.half_m).T, solids.heading_rad).T
    return np.asarray(outward / np.linalg.norm(outward, axis=-1, keepdims=True))
