"""The LiDARs: one that spins on the roof, and four of short range around the car."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from upvl_cli.synthetic.cast import Caster, RayHits, Rays
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, array

TURN_S = 0.1
TILE = 16
ROOF_M = (1.4, 0.0, 2.1)  # the mount of the spinning one, in ego axes
COLUMNS = 2500
REACH_M = 80.0
# 64 beams as on the Waymo car, closest around the horizon: Sun et al., CVPR 2020, section 3 (-17.6 to 2.4 degrees).
ELEVATION_RAD = np.deg2rad(np.concatenate([np.linspace(-17.6, -7.2, 24), np.linspace(-6.9, 2.4, 40)]))
SHORT_REACH_M = 20.0
SHORT_MOUNTS_M = ((3.6, 0.0, 0.7), (1.8, 0.95, 0.9), (1.8, -0.95, 0.9), (-0.9, 0.0, 0.9))
SHORT_YAW_RAD = (0.0, np.pi / 2, -np.pi / 2, np.pi)
RANGE_NOISE_M = 0.015
INTENSITY_NOISE = 0.02
FAR_DROPOUT = 0.2  # share lost at the end of the reach
GRAZING_DROPOUT = 0.5  # share lost where the surface lies along the ray
SPREAD_RAD = 0.002  # of the beam: on a slanted surface it returns over a stretch of ranges


@dataclass(frozen=True)
class Returns(ParallelArrays):
    """What the LiDARs measure.

    Attributes:
        xyz_world_m: (n, 3) places in world axes, with noise, each at its own time.
        intensity: (n,) 0 to 1.
        elongation: (n,) metres over which the return is spread.
        sensor: (n,) 0 for the one on the roof.
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
def directions() -> tuple[Floats, Floats, Ints, Ints]:
    """All rays of a sweep in ego axes: starts (n, 3), ways (n, 3), columns (n,) of the roof's, sensors (n,).

    The roof's mirror turns clockwise and looks ahead at the time of the frame, as on KITTI's car. The others
    measure at once, at that time.
    """
    fans = [_fan(np.pi - (np.arange(COLUMNS) + 0.5) * (2 * np.pi / COLUMNS), ELEVATION_RAD)]
    for yaw in SHORT_YAW_RAD:
        fans.append(_fan(yaw + np.deg2rad(np.linspace(-75, 75, 151)), np.deg2rad(np.linspace(-45, 15, 21))))
    counts = [len(fan) for fan in fans]
    sensor = np.repeat(np.arange(len(fans)), counts)
    column = np.full(len(sensor), COLUMNS // 2)
    column[: counts[0]] = np.repeat(np.arange(COLUMNS), len(ELEVATION_RAD))
    return np.array([ROOF_M, *SHORT_MOUNTS_M])[sensor], np.concatenate(fans), column, sensor


def _fan(azimuth_rad: Array, elevation_rad: Array) -> Floats:
    """(columns x rows, 3) unit directions, column by column."""
    azimuth, elevation = np.meshgrid(azimuth_rad, elevation_rad, indexing="ij")
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(
        -1, 3
    )


@cache
def _tiles(total: int) -> tuple[Ints, Ints]:
    """Return the numbers of all rays tile by tile, and where each is among them: neighbours are cast together."""
    column, row = np.divmod(np.arange(COLUMNS * len(ELEVATION_RAD)), len(ELEVATION_RAD))
    roof = np.lexsort((row, column, row // TILE, column // TILE))
    tiles = np.append(roof, np.arange(len(roof), total))
    return tiles, np.argsort(tiles)


def rays_at(caster: Caster, time_s: float) -> tuple[Rays, Ints]:
    """Return the rays of the sweep around a time, and the sensor of each."""
    start, way, column, sensor = directions()
    moments_s = time_s + ((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5) * TURN_S
    ego = caster.scene.ego.at(moments_s).chosen(column)
    rays = Rays(ego.world(start).astype(np.float32), ego.outward(way).astype(np.float32), column, moments_s)
    return rays, sensor


def sweep(caster: Caster, time_s: float, noisy: float, rng: np.random.Generator) -> tuple[Returns, RayHits]:
    """One turn of the LiDARs around a time.

    Args:
        caster: The city.
        time_s: When the mirror looks ahead.
        noisy: Factor on the usual noise of ranges.
        rng: Source of all noise.

    Returns:
        The returns, and what each met.
    """
    rays, sensor = rays_at(caster, time_s)
    times = rays.moments_s[rays.moment]
    tiles, by_column = _tiles(len(times))
    hits = caster.cast(rays.chosen(tiles), reach_m=REACH_M)[by_column]
    surfaces = caster.scene.surfaces
    reflectance, dropout, depth_m = (
        np.array([getattr(surface, name) for surface in surfaces])[hits.surface]
        for name in ("reflectance", "dropout", "depth_m")
    )
    lost, inward = rng.random((2, len(times)))
    noise, flicker = rng.normal(size=(2, len(times)))
    facing = np.abs(np.einsum("ni,ni->n", hits.normal, rays.way))
    reach = np.where(sensor == 0, REACH_M, SHORT_REACH_M)
    seen = hits.range_m < reach
    far = np.where(seen, hits.range_m, reach) / reach
    dropped = dropout + FAR_DROPOUT * far**2 + GRAZING_DROPOUT * np.maximum(1 - facing / 0.1, 0)
    kept = np.flatnonzero(seen & (lost >= dropped))
    range_m = hits.range_m + depth_m * inward + noisy * RANGE_NOISE_M * noise
    slanted_m = SPREAD_RAD * hits.range_m * np.sqrt(np.maximum(1 / np.maximum(facing, 0.05) ** 2 - 1, 0))
    returns = Returns(
        xyz_world_m=rays.start_m[kept] + rays.way[kept] * range_m[kept, None],
        intensity=np.clip(reflectance * np.sqrt(facing) + INTENSITY_NOISE * flicker, 0, 1)[kept],
        elongation=(depth_m * (1 - inward) + np.minimum(slanted_m, 1))[kept],
        sensor=sensor[kept],
        time_s=times[kept],
        ray=kept,
    )
    return returns, hits[kept]
