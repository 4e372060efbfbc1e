"""Checks of the made-up city's truth by other ways than those it is made by; for tests and bench/city_truth.py."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.synthetic.cast import Caster, Rays
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.types import Array, Bools, Camera, Floats

SEEN_M = 0.05  # a camera sees a point when nothing is more than this nearer


class Projection(NamedTuple):
    """How points and pixels agree.

    Attributes:
        inner: Share of the visible points inside of objects whose pixel shows the same object.
        silhouette: Share of those at the edges with a pixel of their object not more than half a pixel away.
        strict: Share of those at the edges whose own pixel, which shows what its centre sees, is of their object.
        points: How many points were visible.
    """

    inner: float
    silhouette: float
    strict: float
    points: int


def pose_at(drive: CityDrive, time_s: float) -> Array:
    """(4, 4) world_from_ego at any time."""
    placed = drive.scene.ego.at(np.array([time_s]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = placed.rotation[0], placed.place_m[0]
    return pose


def first_on_way(caster: Caster, from_m: Array, to_m: Array, time_s: float) -> tuple[Floats, Array]:
    """Distance and thing of what is first met from one place towards each of (n, 3) others."""
    way = to_m - from_m
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    starts = np.broadcast_to(np.float32(from_m), way.shape)
    rays = Rays(starts, way.astype(np.float32), np.zeros(len(way), np.int64), np.array([time_s]))
    hits = caster.cast(rays, reach_m=300.0)
    return hits.range_m, hits.thing


def projection(drive: CityDrive, frame: int, camera: Camera) -> Projection:
    """Compare the points of a sweep with the pixels that they fall on."""
    caster = Caster(drive.scene)
    points, truth = drive.points_with_truth(frame)
    _, pixels = drive.image_with_truth(frame, camera.name)
    time_s = frame / drive.rate_hz + drive.trigger_s(camera.name)
    # Where each point is when the camera looks: what moves has moved since the LiDAR saw it.
    late_s = time_s - (frame / drive.rate_hz + points.time_offset_ns / 1e9)
    xyz = points.xyz_ego_m + truth.velocity_mps * late_s[:, None]
    world = apply(drive.world_from_ego[frame], xyz)
    pose = pose_at(drive, time_s)
    uv, _, inside = project(camera, apply(inverse(pose), world))
    eye = apply(pose, camera.ego_from_camera[None, :3, 3])[0]
    index = np.flatnonzero(inside)
    far = np.linalg.norm(world[index] - eye, axis=1)
    met_m, _ = first_on_way(caster, eye, world[index], time_s)
    index = index[np.abs(met_m - far) < SEEN_M]
    column, row = np.rint(uv[index]).astype(np.int64).T
    own = truth.name[index] * 10_000 + truth.thing[index]
    shown = pixels.name.astype(np.int64) * 10_000 + pixels.thing
    padded = np.pad(shown, 1, mode="edge")
    window = np.stack(
        [padded[row + 1 + down, column + 1 + right] for down in (-1, 0, 1) for right in (-1, 0, 1)]
    )
    inner = (window == window[4]).all(axis=0)
    right = own == window[4]
    # Pixels whose square lies within half a pixel of where the point falls.
    off = uv[index] - np.stack([column, row], axis=1)
    near = np.zeros(len(index), dtype=np.bool_)
    steps = [(down, across) for down in (-1, 0, 1) for across in (-1, 0, 1)]
    for (down, across), values in zip(steps, window, strict=True):
        gap = np.maximum(np.abs(np.array([across, down]) - off) - 0.5, 0)
        near |= (values == own) & (np.hypot(*gap.T) <= 0.5)
    at_edge = ~inner
    return Projection(
        float(right[inner].mean()), float(near[at_edge].mean()), float(right[at_edge].mean()), len(index)
    )


def flow_residual_m(drive: CityDrive, frame: int) -> Floats:
    """(n,) how far points of rigid movers, moved by their true flow, lie off their object one sweep later.

    Measured along rays of the next sweep; only where the object is seen again.
    """
    caster = Caster(drive.scene)
    points, truth = drive.points_with_truth(frame)
    rigid = np.array([len(thing.model.parts) == 1 and thing.motion.moves for thing in drive.scene.things])
    chosen = np.flatnonzero((truth.thing >= 0) & rigid[truth.thing] & (points.sensor == 0))
    world = apply(
        drive.world_from_ego[frame], points.xyz_ego_m[chosen] + truth.velocity_mps[chosen] / drive.rate_hz
    )
    residual = []
    time_ns = points.time_offset_ns[chosen]
    for column in np.unique(time_ns)[::20]:
        here = np.flatnonzero(time_ns == column)
        time_s = (frame + 1) / drive.rate_hz + column / 1e9
        eye = apply(pose_at(drive, time_s), np.array([drive.sensors.lidars[0].mount_m]))[0]
        met_m, thing = first_on_way(caster, eye, world[here], time_s)
        seen: Bools = thing == truth.thing[chosen[here]]
        far = np.linalg.norm(world[here] - eye, axis=1)
        residual.append(np.abs(met_m - far)[seen])
    return np.concatenate(residual)
