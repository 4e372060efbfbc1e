"""A made-up street, computed when it is asked for, the same for the same seed: the tests' quick world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, inverse, wrap_angle
from upvl_cli.types import Array, Camera, Frame, Image, ParallelArrays, Points, array
from world.layout import street
from world.scene import Solids, solids_at
from world.sensors import FRONT, picture, sweep

RATE_HZ = 10
# Each purpose has random numbers of its own, so that the order of calls changes nothing.
_STREET, _SWEEP = 0, 1


@dataclass(frozen=True)
class PointTruth(ParallelArrays):
    """What is true of each point of a sweep, in the order of its points.

    Attributes:
        object_index: (n,) number of the thing in the drive's scene; -1 for the ground.
        velocity_mps: (n, 3) over the ground along the ego axes: the way of that place of the surface
            until the next frame, divided by the time until then.
    """

    object_index: Array = array("int64")
    velocity_mps: Array = array("float64", 3)


class StreetDrive:
    """A drive along one made-up street (a `Drive`)."""

    cameras: tuple[Camera, ...] = (FRONT,)
    skipped: Mapping[str, int] = MappingProxyType({})
    ground_z_m = 0.0
    files: tuple[Path, ...] = ()

    def __init__(self, *, name: str, seed: int, frames: int) -> None:
        """Lay out the street; sweeps and pictures are computed when they are asked for."""
        self.name = name
        self.frames = tuple(Frame(index, index * 10**9 // RATE_HZ) for index in range(frames))
        self.scene = street(np.random.default_rng([seed, _STREET]))
        self._ego_poses: Array = np.array(
            [self.scene.world_from(self.scene.ego, frame.index / RATE_HZ) for frame in self.frames]
        )
        self._seed = seed

    @property
    def world_from_ego(self) -> Array:
        """(T, 4, 4) pose of each of `frames`, exact."""
        return self._ego_poses

    def points(self, frame: int) -> Points:
        """Return the sweep of the frame of that index."""
        return self.points_with_truth(frame)[0]

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of the frame of that index; only the camera "front" takes some."""
        if camera != FRONT.name:
            raise BadInput(f"{self.name} has no camera {camera!r}; it has {FRONT.name!r}")
        solids = self._solids(frame)
        rgb = picture(self._ego_poses[frame], FRONT, solids, self.scene.ground)
        return Image(rgb=rgb, time_ns=self.frames[frame].time_ns)

    def truth(self, frame: int) -> PointTruth:
        """Return what is true of each point of `points(frame)`; for tests and evaluation only."""
        return self.points_with_truth(frame)[1]

    def points_with_truth(self, frame: int) -> tuple[Points, PointTruth]:
        """Return a sweep and what is true of its points; for tests and evaluation only."""
        now, later = self._solids(frame), solids_at(self.scene, (frame + 1) / RATE_HZ)
        pose = self._ego_poses[frame]
        rng = np.random.default_rng([self._seed, _SWEEP, frame])
        returns = sweep(pose, now, self.scene.ground, rng)
        points = Points(
            xyz_ego_m=apply(inverse(pose), returns.xyz_world_m),
            intensity=returns.intensity,
            elongation=returns.elongation,
            sensor=np.zeros(len(returns)),
            time_offset_ns=np.zeros(len(returns)),
        )
        met = returns.solid >= 0
        solid = returns.solid[met]
        thing, moved_m = np.full(len(returns), -1), np.zeros((len(returns), 3))
        thing[met] = now.thing[solid]
        moved_m[met] = _moved(returns.xyz_world_m[met], now[solid], later[solid])
        return points, PointTruth(object_index=thing, velocity_mps=moved_m @ pose[:3, :3] * RATE_HZ)

    def _solids(self, frame: int) -> Solids:
        if not 0 <= frame < len(self.frames):
            raise BadInput(f"{self.name} has no frame {frame}; it has the frames 0 to {len(self.frames) - 1}")
        return solids_at(self.scene, frame / RATE_HZ)


def _moved(xyz_m: Array, now: Solids, later: Solids) -> Array:
    """Return the (n, 3) ways of points that are fixed to one solid each; exactly 0 where it rests."""
    turn_rad = wrap_angle(later.heading_rad - now.heading_rad)
    x, y, _ = (xyz_m - now.centre_m).T
    cos, sin = np.cos(turn_rad) - 1.0, np.sin(turn_rad)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y, np.zeros_like(x)], axis=-1)
    return np.asarray(later.centre_m - now.centre_m + turned)


class Streets:
    """The made-up drives of some seeds (a `Dataset`)."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, *, frames: int = 20, seeds: tuple[int, ...] = (0,)) -> None:
        """Offer one street for each seed, each of that many frames.

        Raises:
            BadInput: There is no frame, or a seed is negative.
        """
        if frames < 1:
            raise BadInput(f"a made-up street of {frames} frames: expected 1 or more")
        if any(seed < 0 for seed in seeds):
            raise BadInput(f"seeds {seeds} of the made-up streets: expected none below 0")
        self._frames = frames
        self._seed_of = {f"street-{seed}": seed for seed in seeds}

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all segments, sorted."""
        return tuple(sorted(self._seed_of))

    def open(self, segment: str) -> StreetDrive:
        """Return the drive of that name.

        Raises:
            BadInput: There is no such segment.
        """
        if segment not in self._seed_of:
            known = ", ".join(self.segments)
            raise BadInput(f"the street dataset has no segment {segment!r}; it has {known}")
        return StreetDrive(name=segment, seed=self._seed_of[segment], frames=self._frames)
