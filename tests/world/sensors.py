"""The sensors of the made-up drive: a spinning LiDAR on the roof and a camera behind the windscreen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array, Camera, ParallelArrays, array
from world.cast import Hits, cast
from world.scene import MATERIALS, Ground, Solids

LIDAR_HEIGHT_M = 1.8
LIDAR_REACH_M = 75.0
LIDAR_COLUMNS = 1080
# Beams stand closest around the horizon, where the street is far away.
LIDAR_ELEVATION_DEG = np.concatenate([np.linspace(-25, -9, 11), np.linspace(-8.6, 1.2, 28), [3.0, 6.0, 10.0]])
RANGE_NOISE_M = 0.02
INTENSITY_NOISE = 0.02
FAR_DROPOUT = 0.25  # share of rays lost at the end of the reach, beside what the material loses
CAMERA_REACH_M = 250.0
SUN = np.array([-0.5, 0.45, 0.74])  # direction to it, of length 1 within 1 %
SHADE = 0.5  # brightness of a surface that the sun does not meet
SKY_RGB = np.array([[206.0, 220.0, 232.0], [104.0, 152.0, 212.0]])  # at the horizon, overhead

FRONT = Camera(
    name="front",
    width_px=480,
    height_px=270,
    intrinsic=np.array([[300.0, 0.0, 239.5], [0.0, 300.0, 134.5], [0.0, 0.0, 1.0]]),
    distortion=np.zeros(5),
    ego_from_camera=np.array(
        [[0.0, 0.0, 1.0, 0.6], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
    ),
)


@dataclass(frozen=True)
class Returns(ParallelArrays):
    """What the LiDAR measures of a scene.

    Attributes:
        xyz_world_m: (n, 3) places in world axes, with noise.
        intensity: (n,) 0 to 1.
        elongation: (n,) metres by which the return is spread.
        solid: (n,) number of the solid that gave it; -1 for the ground.
    """

    xyz_world_m: Array = array("float64", 3)
    intensity: Array = array("float64")
    elongation: Array = array("float64")
    solid: Array = array("int64")


def sweep(world_from_ego: Array, solids: Solids, ground: Ground, rng: np.random.Generator) -> Returns:
    """Return one turn of the LiDAR, seen at one instant.

    Args:
        world_from_ego: (4, 4) pose of the car.
        solids: What stands on the ground at that time.
        ground: The ground.
        rng: Source of all noise.
    """
    azimuth_rad = (np.arange(LIDAR_COLUMNS) + 0.5) * (2 * np.pi / LIDAR_COLUMNS)
    elevation_rad = np.deg2rad(LIDAR_ELEVATION_DEG)
    level = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros(LIDAR_COLUMNS)], axis=-1)
    rays = level * np.cos(elevation_rad)[:, None, None]
    rays[..., 2] = np.sin(elevation_rad)[:, None]
    rays = _turned(world_from_ego, rays.reshape(-1, 3))  # (beams x columns, 3)
    origin_m = apply(world_from_ego, np.array([[0.0, 0.0, LIDAR_HEIGHT_M]]))[0]
    hits = cast(origin_m, rays, solids, ground, reach_m=LIDAR_REACH_M)

    materials = list(MATERIALS.values())
    reflectance, dropout, depth_m = (
        np.array([getattr(material, name) for material in materials])[hits.material]
        for name in ("reflectance", "dropout", "depth_m")
    )
    lost, inward, noise, flicker = (
        rng.random(len(rays)),
        rng.random(len(rays)),
        *rng.normal(size=(2, len(rays))),
    )
    far = np.minimum(hits.range_m / LIDAR_REACH_M, 1.0)
    kept = np.isfinite(hits.range_m) & (lost >= dropout + FAR_DROPOUT * far**2)
    range_m = hits.range_m + depth_m * inward + RANGE_NOISE_M * noise
    facing = np.abs((hits.normal * rays).sum(axis=1))
    intensity = np.clip(reflectance * np.sqrt(facing) + INTENSITY_NOISE * flicker, 0.0, 1.0)
    return Returns(
        xyz_world_m=origin_m + rays[kept] * range_m[kept, None],
        intensity=intensity[kept],
        elongation=(depth_m * (1 - inward))[kept],
        solid=hits.solid[kept],
    )


def picture(world_from_ego: Array, camera: Camera, solids: Solids, ground: Ground) -> Array:
    """Return the (height, width, 3) uint8 picture that a camera without distortion takes.

    Args:
        world_from_ego: (4, 4) pose of the car.
        camera: The camera.
        solids: What stands on the ground at that time.
        ground: The ground.
    """
    u_px, v_px = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    pixels = np.stack([u_px, v_px, np.ones_like(u_px)], axis=-1).reshape(-1, 3)  # (height x width, 3)
    world_from_camera = world_from_ego @ camera.ego_from_camera
    rays = _turned(world_from_camera, pixels @ np.linalg.inv(camera.intrinsic).T)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = cast(world_from_camera[:3, 3], rays, solids, ground, reach_m=CAMERA_REACH_M)
    rgb = _colours(hits, rays)
    return np.rint(rgb).astype(np.uint8).reshape(camera.height_px, camera.width_px, 3)


def _colours(hits: Hits, rays: Array) -> Array:
    """Return the (n, 3) colours of what the rays meet, the sky included."""
    colours = np.array([material.rgb for material in MATERIALS.values()], dtype=np.float64)
    sun = np.clip(hits.normal @ SUN, 0.0, 1.0)
    surface = colours[hits.material] * (SHADE + (1 - SHADE) * sun)[:, None]
    up = np.clip(rays[:, 2:], 0.0, 1.0)
    sky = SKY_RGB[0] + up * (SKY_RGB[1] - SKY_RGB[0])
    return np.asarray(np.where(hits.material[:, None] >= 0, surface, sky))


def _turned(dst_from_src: Array, directions: Array) -> Array:
    """Return the directions in the axes of dst."""
    return apply(dst_from_src, directions) - dst_from_src[:3, 3]
