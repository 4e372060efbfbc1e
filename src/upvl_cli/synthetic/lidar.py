"""Sweeps of the LiDARs of a sensor preset."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from upvl_cli.synthetic.cast import Caster, RayHits, Rays
from upvl_cli.synthetic.sensors import Lidar, SensorPreset
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, array

TILE = 16
INTENSITY_NOISE = 0.02
GRAZING_DROPOUT = 0.5  # share lost where the surface lies along the ray
SPREAD_RAD = 0.002  # of the beam: on a slanted surface it returns over a stretch of ranges


@dataclass(frozen=True)
class Returns(ParallelArrays):
    """What the LiDARs measure.

    Attributes:
        xyz_world_m: (n, 3) places in world axes, with noise, each at its own time.
        intensity: (n,) 0 to 1.
        elongation: (n,) metres over which the return is spread.
        sensor: (n,) place of its LiDAR in the preset; 0 is the main one.
        time_s: (n,) when each was measured.
        ray: (n,) number of its ray.
    """

    xyz_world_m: Array = array("float64", 3)
    intensity: Array = array("float64")
    elongation: Array = array("float64")
    sensor: Array = array("int64")
    time_s: Array = array("float64")
    ray: Array = array("int64")


@cache
def directions(sensors: SensorPreset) -> tuple[Floats, Floats, Ints, Ints]:
    """All rays of a sweep in ego axes: starts (n, 3), ways (n, 3), moments (n,), LiDARs (n,).

    A mirror that turns does so clockwise and looks ahead at the time of the frame, as on KITTI's car. What measures
    at once does so at that time.
    """
    fans = [_fan(lidar.azimuth_rad, lidar.elevation_rad) for lidar in sensors.lidars]
    counts = [len(fan) for fan in fans]
    total = moments(sensors)
    moment = np.concatenate([_moments_of(lidar, total) for lidar in sensors.lidars])
    sensor = np.repeat(np.arange(len(fans)), counts)
    return np.array([lidar.mount_m for lidar in sensors.lidars])[sensor], np.concatenate(fans), moment, sensor


def moments(sensors: SensorPreset) -> int:
    """At how many times the LiDARs of a preset measure in one sweep."""
    return max(lidar.moments for lidar in sensors.lidars)


def _moments_of(lidar: Lidar, total: int) -> Ints:
    """(columns x rows,) which of all times each ray has."""
    columns, rows = len(lidar.azimuth_rad), len(lidar.elevation_rad)
    if lidar.order == "columns":
        return np.repeat(np.arange(columns), rows)
    return np.tile(np.arange(rows), columns) if lidar.order == "rows" else np.full(columns * rows, total // 2)


def _fan(azimuth_rad: Array, elevation_rad: Array) -> Floats:
    """(columns x rows, 3) unit directions, column by column."""
    azimuth, elevation = np.meshgrid(azimuth_rad, elevation_rad, indexing="ij")
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(
        -1, 3
    )


@cache
def _tiles(sensors: SensorPreset) -> tuple[Ints, Ints]:
    """Return the numbers of all rays tile by tile, and where each is among them: neighbours are cast together."""
    parts, first = [], 0
    for lidar in sensors.lidars:
        rows = len(lidar.elevation_rad)
        number = np.arange(len(lidar.azimuth_rad) * rows)
        column, row = np.divmod(number, rows)
        tiled = np.lexsort((row, column, row // TILE, column // TILE))
        parts.append(first + (number if lidar.order == "flash" else tiled))
        first += len(number)
    tiles = np.concatenate(parts)
    return tiles, np.argsort(tiles)


def rays_at(caster: Caster, sensors: SensorPreset, time_s: float) -> tuple[Rays, Ints]:
    """Return the rays of the sweep around a time, and the LiDAR of each."""
    start, way, moment, sensor = directions(sensors)
    total = moments(sensors)
    moments_s = time_s + ((np.arange(total) + 0.5) / total - 0.5) * sensors.scan_s
    ego = caster.scene.ego.at(moments_s).chosen(moment)
    rays = Rays(ego.world(start).astype(np.float32), ego.outward(way).astype(np.float32), moment, moments_s)
    return rays, sensor


def sweep(
    caster: Caster, sensors: SensorPreset, time_s: float, noisy: float, rng: np.random.Generator
) -> tuple[Returns, RayHits]:
    """One sweep of the LiDARs around a time.

    Args:
        caster: The city.
        sensors: What measures.
        time_s: When the mirror looks ahead.
        noisy: Factor on the usual noise of ranges.
        rng: Source of all noise.

    Returns:
        The returns, and what each met.
    """
    rays, sensor = rays_at(caster, sensors, time_s)
    times = rays.moments_s[rays.moment]
    tiles, by_column = _tiles(sensors)
    hits = caster.cast(rays.chosen(tiles), reach_m=sensors.reach_m)[by_column]
    surfaces = caster.scene.surfaces
    reflectance, dropout, depth_m = (
        np.array([getattr(surface, name) for surface in surfaces])[hits.surface]
        for name in ("reflectance", "dropout", "depth_m")
    )
    lost, inward = rng.random((2, len(times)))
    noise, flicker = rng.normal(size=(2, len(times)))
    facing = np.abs(np.einsum("ni,ni->n", hits.normal, rays.way))
    reach = np.array([lidar.reach_m for lidar in sensors.lidars])[sensor]
    seen = hits.range_m < reach
    far = np.where(seen, hits.range_m, reach) / reach
    dropped = dropout + sensors.far_dropout * far**2 + GRAZING_DROPOUT * np.maximum(1 - facing / 0.1, 0)
    kept = np.flatnonzero(seen & (lost >= dropped))
    range_m = hits.range_m + depth_m * inward + noisy * sensors.range_noise_m * noise
    slanted_m = SPREAD_RAD * hits.range_m * np.sqrt(np.maximum(1 / np.maximum(facing, 0.05) ** 2 - 1, 0))
    intensity = np.clip(reflectance * np.sqrt(facing) + INTENSITY_NOISE * flicker, 0, 1)
    returns = Returns(
        xyz_world_m=rays.start_m[kept] + rays.way[kept] * range_m[kept, None],
        intensity=intensity[kept] if sensors.has_intensity else np.zeros(len(kept)),
        elongation=(depth_m * (1 - inward) + np.minimum(slanted_m, 1))[kept],
        sensor=sensor[kept],
        time_s=times[kept],
        ray=kept,
    )
    return returns, hits[kept]
