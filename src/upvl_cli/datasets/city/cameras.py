"""The cameras: where they look, and the pictures they take."""

from __future__ import annotations

from functools import cache

import numpy as np

from upvl_cli.datasets.city.cast import NOTHING, Caster, Hits, Rays
from upvl_cli.datasets.city.lidar import TURN_S
from upvl_cli.datasets.city.textures import brightness
from upvl_cli.datasets.city.weather import Weather
from upvl_cli.geometry.camera import rays as camera_rays
from upvl_cli.types import Array, Camera, Floats, Ints

WIDTH_PX, HEIGHT_PX = 640, 427
FOCAL_PX = 660.0  # 52 degrees across: neighbours overlap by a few
DISTORTION = (-0.06, 0.012, 0.0004, -0.0003, 0.0)
REACH_M = 250.0
SHADOW_M = 60.0
TILE_PX = 32
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


def trigger_s(name: str) -> float:
    """Seconds after the frame at which a camera exposes: when the LiDAR looks its way."""
    return -YAW_DEG[name] / 360 * TURN_S


def pixel_rays(caster: Caster, seen_by: Camera, time_s: float, rolling_s: float) -> Rays:
    """The rays of all pixels, row by row.

    Args:
        caster: The city.
        seen_by: The camera.
        time_s: When the middle row is exposed.
        rolling_s: From the first row to the last one.
    """
    way = _ways(seen_by.name)
    row = np.arange(len(way)) // seen_by.width_px
    times = time_s + rolling_s * (row / (seen_by.height_px - 1) - 0.5)
    ego = caster.scene.ego.at(times)
    mount = np.tile(seen_by.ego_from_camera[:3, 3], (len(way), 1))
    return Rays(ego.world(mount), ego.outward(way), times)


@cache
def _ways(name: str) -> Floats:
    """(height x width, 3) directions of a camera's pixels in ego axes."""
    seen_by = camera(name)
    v, u = np.divmod(np.arange(seen_by.width_px * seen_by.height_px), seen_by.width_px)
    ways = camera_rays(seen_by, np.stack([u, v], axis=1))
    ways.flags.writeable = False
    return ways


def picture(
    caster: Caster,
    seen_by: Camera,
    time_s: float,
    weather: Weather,
    *,
    rolling_s: float,
    noise: float,
    rng: np.random.Generator,
) -> tuple[Array, Hits]:
    """A picture, (height, width, 3) uint8, and what each pixel shows, row by row.

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
    tiles = _tiles(seen_by.width_px, seen_by.height_px)
    rays = rays.chosen(tiles)
    in_tiles, _ = caster.cast(rays, reach_m=REACH_M)
    by_row = np.argsort(tiles)
    colour, hits = _colours(caster, rays, in_tiles, weather)[by_row], in_tiles[by_row]
    colour *= weather.exposure * np.array([weather.warmth, 1, 1 / weather.warmth])
    colour += noise * weather.noise * 255 * rng.normal(size=colour.shape)
    shape = (seen_by.height_px, seen_by.width_px, 3)
    return np.rint(np.clip(colour, 0, 255)).astype(np.uint8).reshape(shape), hits


def _tiles(width_px: int, height_px: int) -> Ints:
    """The numbers of all pixels, tile by tile: rays that follow each other are to lie close together."""
    v, u = np.divmod(np.arange(width_px * height_px), width_px)
    return np.lexsort((u, v, u // TILE_PX, v // TILE_PX))


def _colours(caster: Caster, rays: Rays, hits: Hits, weather: Weather) -> Floats:
    """(n, 3) what the rays bring, 0 to 255."""
    colour = _sky(rays.way, weather)
    met = np.flatnonzero(hits.surface != NOTHING)
    here, seen = hits[met], rays.chosen(met)
    surfaces = caster.scene.surfaces
    own = np.array([surface.rgb for surface in surfaces], dtype=np.float64)[here.surface]
    textures = np.array([surface.texture for surface in surfaces])[here.surface]
    for texture in np.unique(textures):
        mine = np.flatnonzero(textures == texture)
        if texture != "plain":
            own[mine] *= brightness(texture, here.local_m[mine], here.normal[mine])[:, None]
    facing = np.maximum(here.normal @ weather.sun, 0)
    lit = np.flatnonzero(facing > 0)
    at = seen.start_m + here.range_m[:, None] * seen.way
    to_sun = Rays(at[lit] + 2e-3 * here.normal[lit], np.tile(weather.sun, (len(lit), 1)), seen.time_s[lit])
    facing[lit[caster.shaded(to_sun, reach_m=SHADOW_M)]] = 0
    # The sky lights what looks up more than what looks down.
    light = (1 - weather.sun_share) * (0.7 + 0.3 * here.normal[:, 2]) + 1.35 * weather.sun_share * facing
    shown = own * light[:, None]
    gloss = np.array([surface.gloss for surface in surfaces])[here.surface]
    mirror = seen.way - 2 * np.einsum("ni,ni->n", seen.way, here.normal)[:, None] * here.normal
    shown += gloss[:, None] * np.where(mirror[:, 2:] > 0, _sky(mirror, weather) - shown, 0) * 0.6
    clear = np.exp(-here.range_m / weather.visibility_m)[:, None]
    colour[met] = clear * shown + (1 - clear) * weather.sky_rgb[0]
    return colour


def _sky(way: Array, weather: Weather) -> Floats:
    up = np.sqrt(np.clip(way[:, 2:], 0, 1))
    glow = np.maximum(way @ weather.sun, 0)[:, None] ** 64 * weather.sun_share
    sky = weather.sky_rgb[0] + up * (weather.sky_rgb[1] - weather.sky_rgb[0])
    return np.asarray(sky + glow * (255 - sky))
