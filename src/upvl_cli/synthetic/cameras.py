"""The cameras: where they look, and the pictures they take."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from upvl_cli.geometry.camera import rays as camera_rays
from upvl_cli.synthetic.cast import NOTHING, Caster, RayHits, Rays
from upvl_cli.synthetic.surface import Finish
from upvl_cli.synthetic.textures import TEXTURES, brightness
from upvl_cli.synthetic.weather import Weather
from upvl_cli.types import Array, Camera, Floats, Ints

WIDTH_PX, HEIGHT_PX = 640, 427
FOCAL_PX = 660.0  # 52 degrees across: neighbours overlap by a few
DISTORTION = (-0.06, 0.012, 0.0004, -0.0003, 0.0)
REACH_M = 250.0
SHADOW_M = 60.0
TILE_PX = 16
OFF_M = np.float32(2e-3)  # a shadow is looked for this far off its surface
MIRROR = np.float32(0.6)  # share of the sky that the best mirror shows
# As on the Waymo car: nothing looks back.
YAW_DEG = {"front": 0, "front-left": 45, "front-right": -45, "side-left": 90, "side-right": -90}
MOUNT_M = (1.5, 0.0, 1.95)
AROUND_M = 0.25  # each camera sits this far from the mount


def camera(name: str) -> Camera:
    """One of the five."""
    yaw = np.deg2rad(YAW_DEG[name])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([-left, [0, 0, -1], ahead])
    pose[:3, 3] = np.array(MOUNT_M) + AROUND_M * ahead
    return Camera(
        name=name,
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        intrinsic=np.array(
            [[FOCAL_PX, 0, (WIDTH_PX - 1) / 2], [0, FOCAL_PX, (HEIGHT_PX - 1) / 2], [0, 0, 1]]
        ),
        distortion=np.array(DISTORTION),
        ego_from_camera=pose,
    )


CAMERAS = tuple(camera(name) for name in YAW_DEG)


def trigger_s(name: str, turn_s: float) -> float:
    """Seconds after the frame at which a camera exposes: when the LiDAR looks its way.

    Args:
        name: Of the camera.
        turn_s: How long a turn of the LiDAR takes; 0 where it does not turn.
    """
    return -YAW_DEG[name] / 360 * turn_s


def pixel_rays(caster: Caster, seen_by: Camera, time_s: float, rolling_s: float) -> Rays:
    """Return the rays of all pixels, in the order of `tiles`.

    Args:
        caster: The city.
        seen_by: The camera.
        time_s: When the middle row is exposed.
        rolling_s: From the first row to the last one.
    """
    order, _ = tiles(seen_by.width_px, seen_by.height_px)
    way, mount = _ways(seen_by.name), seen_by.ego_from_camera[:3, 3]
    row = order // seen_by.width_px
    moments_s = time_s + rolling_s * (np.arange(seen_by.height_px) / (seen_by.height_px - 1) - 0.5)
    ego = caster.scene.ego.at(moments_s).chosen(row)
    starts = ego.world(np.broadcast_to(mount, way.shape)).astype(np.float32)
    return Rays(starts, ego.outward(way).astype(np.float32), row, moments_s)


@cache
def _ways(name: str) -> Array:
    """(height x width, 3) float32 directions of a camera's pixels in ego axes, in the order of `tiles`."""
    order, _ = tiles(WIDTH_PX, HEIGHT_PX)
    ways = (_ways_of_front() @ camera(name).ego_from_camera[:3, :3].T).astype(np.float32)[order]
    ways.flags.writeable = False
    return ways


@cache
def _ways_of_front() -> Floats:
    """Return the same in the axes of the camera: all five have the same lens."""
    front = camera("front")
    v, u = np.divmod(np.arange(front.width_px * front.height_px), front.width_px)
    return camera_rays(front, np.stack([u, v], axis=1)) @ front.ego_from_camera[:3, :3]


def picture(
    caster: Caster,
    seen_by: Camera,
    time_s: float,
    weather: Weather,
    *,
    rolling_s: float,
    noise: float,
    rng: np.random.Generator,
) -> tuple[Array, RayHits]:
    """Return a picture, (height, width, 3) uint8, and what each pixel shows, in the order of `tiles`.

    Args:
        caster: The city.
        seen_by: The camera.
        time_s: When its middle row is exposed.
        weather: Light and air.
        rolling_s: From the first row to the last one.
        noise: Factor on the usual noise.
        rng: Source of the noise.
    """
    rays = pixel_rays(caster, seen_by, time_s, rolling_s)
    hits = caster.cast(rays, reach_m=REACH_M)
    colour = _colours(caster, rays, hits, weather)[tiles(seen_by.width_px, seen_by.height_px)[1]]
    colour *= np.float32(weather.exposure) * np.array([weather.warmth, 1, 1 / weather.warmth], np.float32)
    colour += np.float32(noise * weather.noise * 255) * rng.standard_normal(colour.shape, dtype=np.float32)
    shape = (seen_by.height_px, seen_by.width_px, 3)
    return np.rint(np.clip(colour, 0, 255)).astype(np.uint8).reshape(shape), hits


@cache
def tiles(width_px: int, height_px: int) -> tuple[Ints, Ints]:
    """Return the numbers of all pixels tile by tile, and where each pixel is among them.

    Rays that follow each other are to lie close together.
    """
    v, u = np.divmod(np.arange(width_px * height_px), width_px)
    order = np.lexsort((u, v, u // TILE_PX, v // TILE_PX))
    return order, np.argsort(order)


def _colours(caster: Caster, rays: Rays, hits: RayHits, weather: Weather) -> Array:
    """(n, 3) float32, what the rays bring, 0 to 255."""
    rgb, texture, gloss = _palette(caster.scene.surfaces)
    shown = rgb[hits.surface]
    of = texture[hits.surface]
    for number, name in enumerate(TEXTURES):
        mine = np.flatnonzero(of == number)
        if name != "plain" and len(mine):
            shown[mine] *= brightness(name, hits.local_m[mine], hits.normal[mine])[:, None].astype(np.float32)
    shown *= _light(caster, rays, hits, weather)[:, None]
    mirrors = np.flatnonzero(gloss[hits.surface] > 0)
    way, normal = rays.way[mirrors], hits.normal[mirrors]
    back = way - 2 * np.einsum("ni,ni->n", way, normal)[:, None] * normal
    share = MIRROR * gloss[hits.surface[mirrors], None] * (back[:, 2:] > 0)
    shown[mirrors] += share * (_sky(back, weather) - shown[mirrors])
    hazy = weather.sky_rgb[0].astype(np.float32)
    shown -= hazy
    shown *= np.exp(-hits.range_m / np.float32(weather.visibility_m))[:, None]
    shown += hazy
    sky = np.flatnonzero(hits.surface == NOTHING)
    shown[sky] = _sky(rays.way[sky], weather)
    return shown


def _light(caster: Caster, rays: Rays, hits: RayHits, weather: Weather) -> Array:
    """(n,) float32, how much light each place gets from the sun and the sky."""
    sun = weather.sun.astype(np.float32)
    facing = np.maximum(hits.normal @ sun, 0)
    lit = np.flatnonzero((facing > 0) & (hits.surface != NOTHING))
    if weather.sun_share > 0:
        at = rays.start_m[lit] + hits.range_m[lit, None] * rays.way[lit] + OFF_M * hits.normal[lit]
        to_sun = Rays(at, np.broadcast_to(sun, at.shape), rays.moment[lit], rays.moments_s)
        facing[lit[caster.shaded(to_sun, reach_m=SHADOW_M)]] = 0
    # The sky lights what looks up more than what looks down.
    from_sky = np.float32(1 - 0.75 * weather.sun_share) * (
        np.float32(0.7) + np.float32(0.3) * hits.normal[:, 2]
    )
    return np.asarray(from_sky + np.float32(1.35 * weather.sun_share) * facing)


@lru_cache(maxsize=4)
def _palette(surfaces: tuple[Finish, ...]) -> tuple[Array, Ints, Array]:
    """Colour, place of the texture in `TEXTURES` and gloss of each surface; the last one is nothing."""
    names = list(TEXTURES)
    rgb = np.array([*(surface.rgb for surface in surfaces), (0, 0, 0)], dtype=np.float32)
    texture = np.array([*(names.index(surface.texture) for surface in surfaces), names.index("plain")])
    gloss = np.array([*(surface.gloss for surface in surfaces), 0], dtype=np.float32)
    return rgb, texture, gloss


def _sky(way: Array, weather: Weather) -> Array:
    horizon, top = weather.sky_rgb.astype(np.float32)
    up = np.sqrt(np.clip(way[:, 2:], 0, 1))
    glow = np.maximum(way @ weather.sun.astype(np.float32), 0)[:, None]
    for _ in range(6):
        glow = glow * glow
    sky = horizon + up * (top - horizon)
    return np.asarray(sky + np.float32(weather.sun_share) * glow * (255 - sky))
