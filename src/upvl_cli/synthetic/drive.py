"""One drive through the made-up city: what its sensors see, and what is true of it."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.synthetic.build import build
from upvl_cli.synthetic.cameras import CAMERAS, picture, tiles, trigger_s
from upvl_cli.synthetic.cast import Caster, RayHits, world_places
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.lidar import rays_at, sweep
from upvl_cli.synthetic.scene import CityScene
from upvl_cli.synthetic.sensors import SENSORS
from upvl_cli.synthetic.weather import Weather, weather
from upvl_cli.types import Array, Camera, Floats, Frame, Image, ParallelArrays, Points, array

FIRST_NS = 10**9  # no time is negative, not even of what is seen before the first frame
KEPT_SWEEPS = 64  # 4 MB each: the stages of one run read them again
_SWEEP, _PICTURE, _WEATHER = 10, 11, 12


@dataclass(frozen=True)
class PointTruth(ParallelArrays):
    """What is true of each point of a sweep, in the order of its points.

    Attributes:
        thing: (n,) number of the thing in the scene; -1 for what never moves.
        name: (n,) place in the scene's `names`.
        velocity_mps: (n, 3) over the ground along the ego axes: the way of that place of the surface
            until the next sweep sees it, divided by the time until then.
    """

    thing: Array = array("int64")
    name: Array = array("int64")
    velocity_mps: Array = array("float64", 3)


@dataclass(frozen=True)
class PixelTruth:
    """What is true of each pixel of a picture.

    Attributes:
        name: (height, width) place in the scene's `names`; -1 for the sky.
        thing: (height, width) number of the thing; -1 for what never moves.
        range_m: (height, width) distance from the camera; infinite for the sky.
    """

    name: Array
    thing: Array
    range_m: Array


class CityDrive:
    """A drive (a `Drive`); sweeps and pictures are computed when they are asked for."""

    cameras: tuple[Camera, ...] = CAMERAS
    skipped: Mapping[str, int] = MappingProxyType({})
    ground_z_m = 0.0
    files: tuple[Path, ...] = ()

    def __init__(
        self, *, name: str, seed: Sequence[int], without: Sequence[str], settings: CityConfig
    ) -> None:
        """Name the drive; its city is built when the first sweep or picture is asked for."""
        self.name = name
        self.sensors = SENSORS[settings.sensor]
        self.rate_hz = self.sensors.rate_hz
        self.frames = tuple(
            Frame(index, FIRST_NS + index * 10**9 // self.rate_hz) for index in range(settings.frames)
        )
        self._seed = tuple(seed)
        self._without = tuple(without)
        self._settings = settings
        self._kept: dict[int, Points] = {}
        self._building = threading.Lock()
        self._built: Caster | None = None

    @cached_property
    def scene(self) -> CityScene:
        """The city and all that moves in it; the truth, so for evaluation only."""
        return build(
            self._seed,
            without=self._without,
            seconds=len(self.frames) / self.rate_hz,
            density=self._settings.density,
            clutter=self._settings.clutter,
        )

    @cached_property
    def weather(self) -> Weather:
        """Light and air of the drive."""
        return weather(
            np.random.default_rng([*self._seed, _WEATHER]),
            light=self._settings.light,
            haze=self._settings.haze,
        )

    @property
    def _caster(self) -> Caster:
        with self._building:  # sweeps and pictures are asked for by several threads
            if self._built is None:
                self._built = Caster(self.scene)
            return self._built

    @cached_property
    def world_from_ego(self) -> Array:
        """(T, 4, 4) pose of each of `frames`, exact."""
        placed = self.scene.ego.at(np.array([frame.index / self.rate_hz for frame in self.frames]))
        poses = np.tile(np.eye(4), (len(self.frames), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = placed.rotation, placed.place_m
        return poses

    def points(self, frame: int) -> Points:
        """Return the sweep of the frame of that index, motion-compensated to its time."""
        kept = self._kept.get(frame)
        if kept is None:
            kept = self._kept[frame] = self._sweep(frame)[0]
            while len(self._kept) > KEPT_SWEEPS:
                self._kept.pop(next(iter(self._kept)), None)
        return kept

    def points_with_truth(self, frame: int) -> tuple[Points, PointTruth]:
        """Return a sweep and what is true of its points; the truth is for evaluation only."""
        points, hits, time_s = self._sweep(frame)
        moved = self._moved_m(hits, time_s)
        to_ego = self.world_from_ego[frame][:3, :3]
        return points, PointTruth(hits.thing, hits.name, moved @ to_ego * self.rate_hz)

    def _sweep(self, frame: int) -> tuple[Points, RayHits, Floats]:
        """Return the points of a sweep, what each lies on, and the time of each."""
        time_s, caster = self._time_s(frame), self._caster
        rng = np.random.default_rng([*self._seed, _SWEEP, frame])
        returns, hits = sweep(caster, self.sensors, time_s, self._settings.noise, rng)
        points = Points(
            xyz_ego_m=apply(inverse(self.world_from_ego[frame]), returns.xyz_world_m),
            intensity=returns.intensity,
            elongation=returns.elongation,
            sensor=returns.sensor,
            time_offset_ns=np.rint((returns.time_s - time_s) * 1e9),
        )
        return points, hits, returns.time_s

    def visible(self, frame: int) -> Floats:
        """(t,) share of the LiDARs' rays that would meet each thing alone which do meet it; NaN where none would."""
        rays, _ = rays_at(self._caster, self.sensors, self._time_s(frame))
        thing = self._caster.cast(rays, reach_m=self.sensors.reach_m).thing
        alone = self._caster.alone(rays, reach_m=self.sensors.reach_m)
        seen = np.bincount(thing[thing >= 0], minlength=len(alone))
        return np.asarray(seen / np.where(alone > 0, alone, np.nan))

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of the frame of that index."""
        return self._picture(frame, camera)[0]

    def image_with_truth(self, frame: int, camera: str) -> tuple[Image, PixelTruth]:
        """Return a picture and what each of its pixels shows; the truth is for evaluation only."""
        image, in_tiles = self._picture(frame, camera)
        height_px, width_px, _ = image.rgb.shape
        hits = in_tiles[tiles(width_px, height_px)[1]]
        return image, PixelTruth(
            *(values.reshape(height_px, width_px) for values in (hits.name, hits.thing, hits.range_m))
        )

    def trigger_s(self, camera: str) -> float:
        """Seconds after the frame at which a camera exposes: when the LiDAR looks its way."""
        return trigger_s(camera, self.sensors.scan_s if self.sensors.spins else 0.0)

    def _picture(self, frame: int, camera: str) -> tuple[Image, RayHits]:
        """Return a picture, and what its pixels show, tile by tile."""
        known = [one.name for one in CAMERAS]
        if camera not in known:
            raise BadInput(f"{self.name} has no camera {camera!r}; it has {', '.join(known)}")
        time_s = self._time_s(frame) + self.trigger_s(camera)
        rgb, hits = picture(
            self._caster,
            CAMERAS[known.index(camera)],
            time_s,
            self.weather,
            rolling_s=self._settings.rolling_s,
            noise=self._settings.noise,
            rng=np.random.default_rng([*self._seed, _PICTURE, frame, known.index(camera)]),
        )
        return Image(rgb, FIRST_NS + round(time_s * 1e9)), hits

    def _moved_m(self, hits: RayHits, time_s: Floats) -> Floats:
        moved = np.zeros((len(hits), 3))
        # Exactly 0 where nothing moves, and not a rounding error.
        goes = np.array([thing.motion.moves for thing in self.scene.things] + [False])[hits.thing]
        moving, then_s = hits[goes], time_s[goes] + 1 / self.rate_hz
        moved[goes] = world_places(self.scene, moving, then_s) - world_places(
            self.scene, moving, time_s[goes]
        )
        return moved

    def _time_s(self, frame: int) -> float:
        if not 0 <= frame < len(self.frames):
            raise BadInput(f"{self.name} has no frame {frame}; it has the frames 0 to {len(self.frames) - 1}")
        return frame / self.rate_hz
