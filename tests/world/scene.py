"""What a made-up street consists of: a ground, and things of simple solids that stand or move on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.se3 import apply, from_yaw, yaw_of
from upvl_cli.types import Array, ParallelArrays, array

BOX, CYLINDER, ELLIPSOID = range(3)  # a cylinder stands upright; all three turn with their thing
STRIDE_HZ = 1.0  # double steps of a walker in a second


class Material(NamedTuple):
    """What light does on a surface.

    Attributes:
        rgb: Colour in a picture, 0 to 255.
        reflectance: Intensity of a LiDAR return that meets it head on, 0 to 1.
        dropout: Share of LiDAR rays that give no return.
        depth_m: How far a ray may go in before it comes back, as in leaves.
    """

    rgb: tuple[int, int, int]
    reflectance: float
    dropout: float
    depth_m: float = 0.0


MATERIALS = {
    "asphalt": Material((92, 92, 96), 0.12, 0.04),
    "marking": Material((225, 225, 220), 0.75, 0.02),
    "kerb": Material((165, 163, 158), 0.30, 0.02),
    "pavement": Material((140, 137, 132), 0.25, 0.02),
    "grass": Material((104, 136, 72), 0.35, 0.03, 0.03),
    "brick": Material((160, 100, 82), 0.35, 0.02),
    "plaster": Material((205, 193, 165), 0.50, 0.02),
    "concrete": Material((158, 158, 152), 0.30, 0.02),
    "steel": Material((120, 124, 128), 0.45, 0.02),
    "bark": Material((94, 72, 54), 0.25, 0.02),
    "leaves": Material((62, 112, 48), 0.40, 0.08, 0.40),
    "rubber": Material((38, 38, 40), 0.06, 0.15),
    "glass": Material((70, 84, 98), 0.15, 0.45),
    "red": Material((172, 34, 38), 0.45, 0.02),
    "white": Material((230, 230, 228), 0.65, 0.02),
    "blue": Material((38, 72, 150), 0.40, 0.02),
    "silver": Material((172, 176, 180), 0.55, 0.02),
    "black": Material((44, 46, 50), 0.10, 0.12),
    "yellow": Material((222, 174, 36), 0.60, 0.02),
    "skin": Material((206, 162, 134), 0.45, 0.02),
    "denim": Material((52, 64, 98), 0.25, 0.02),
}
MATERIAL_NUMBER = {name: number for number, name in enumerate(MATERIALS)}


class Pose(NamedTuple):
    """Where an upright thing stands on the street, in world axes, and where it looks."""

    x_m: float
    y_m: float
    heading_rad: float


@dataclass(frozen=True)
class Motion:
    """A way along a straight line, with one smooth step sideways.

    Attributes:
        start: Pose at time 0.
        speed_mps: Speed at time 0, along the heading.
        brake_mps2: Loss of speed until it stands.
        aside_m: Width of the step to the left.
        aside_s: How long the step takes, from time 0 on.
    """

    start: Pose
    speed_mps: float = 0.0
    brake_mps2: float = 0.0
    aside_m: float = 0.0
    aside_s: float = 1.0

    def at(self, time_s: float) -> Pose:
        """Return the pose of that time."""
        braked_s = min(time_s, self.speed_mps / self.brake_mps2) if self.brake_mps2 else time_s
        along_m = self.speed_mps * braked_s - self.brake_mps2 * braked_s**2 / 2
        along_mps = self.speed_mps - self.brake_mps2 * braked_s
        share = min(max(time_s / self.aside_s, 0.0), 1.0)
        left_m = self.aside_m * (3 - 2 * share) * share**2
        left_mps = self.aside_m * 6 * share * (1 - share) / self.aside_s
        cos, sin = np.cos(self.start.heading_rad), np.sin(self.start.heading_rad)
        return Pose(
            float(self.start.x_m + cos * along_m - sin * left_m),
            float(self.start.y_m + sin * along_m + cos * left_m),
            float(self.start.heading_rad + np.arctan2(left_mps, along_mps)),
        )


class Part(NamedTuple):
    """One solid of a thing.

    Attributes:
        form: BOX, CYLINDER or ELLIPSOID.
        centre_m: x, y, z of its centre, from the ground below the middle of the thing.
        size_lwh_m: Its length, width and height.
        material: Name in `MATERIALS`.
        swing_m: How far it goes forth and back, as a leg does.
    """

    form: int
    centre_m: tuple[float, float, float]
    size_lwh_m: tuple[float, float, float]
    material: str
    swing_m: float = 0.0


@dataclass(frozen=True)
class Thing:
    """Something that stands or moves on the street.

    Attributes:
        kind: Name of the kind of road user, "" for a thing without label.
        size_lwh_m: Size of its label.
        motion: Its way.
        parts: The solids that it consists of.
    """

    kind: str
    size_lwh_m: tuple[float, float, float]
    motion: Motion
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Ground:
    """A ground of strips along x: the same cross section everywhere, lifted by a constant grade.

    Attributes:
        y_m: (k,) where strips end, from right to left.
        z_m: (k,) heights there, at x = 0.
        materials: (k - 1,) names of the strips' materials.
        grade: Rise along x, per metre.
    """

    y_m: tuple[float, ...]
    z_m: tuple[float, ...]
    materials: tuple[str, ...]
    grade: float

    def height_m(self, x_m: Array | float, y_m: Array | float) -> Array:
        """Return the height of the ground at places in world axes."""
        return np.asarray(np.interp(y_m, self.y_m, self.z_m) + self.grade * np.asarray(x_m))


@dataclass(frozen=True)
class Scene:
    """A street, its things, and the way of the car that records it."""

    ground: Ground
    things: tuple[Thing, ...]
    ego: Motion

    def world_from(self, motion: Motion, time_s: float) -> Array:
        """Return the (4, 4) pose of an upright thing on the ground."""
        x_m, y_m, heading_rad = motion.at(time_s)
        return from_yaw(heading_rad, np.array([x_m, y_m, self.ground.height_m(x_m, y_m)]))


@dataclass(frozen=True)
class Solids(ParallelArrays):
    """All solids of a scene at one time, in world axes.

    Attributes:
        form: (n,) BOX, CYLINDER or ELLIPSOID.
        centre_m: (n, 3) places of the centres.
        half_m: (n, 3) half lengths, widths and heights.
        heading_rad: (n,) headings, counter-clockwise from x.
        material: (n,) places in the list of `MATERIALS`.
        thing: (n,) number of the thing in the scene.
    """

    form: Array = array("int8")
    centre_m: Array = array("float64", 3)
    half_m: Array = array("float64", 3)
    heading_rad: Array = array("float64")
    material: Array = array("int64")
    thing: Array = array("int64")


def solids_at(scene: Scene, time_s: float) -> Solids:
    """Return the solids of all things, always in the same order, where they are at that time.

    Args:
        scene: The street.
        time_s: Time since the drive began.
    """
    things, parts = scene.things, [part for thing in scene.things for part in thing.parts]
    thing = np.array([number for number, each in enumerate(things) for _ in each.parts], dtype=np.int64)
    world_from_thing = np.array([scene.world_from(each.motion, time_s) for each in things]).reshape(-1, 4, 4)
    # Where a walker starts decides its step, so that walkers do not march in time.
    phase_rad = 2 * np.pi * STRIDE_HZ * time_s + np.array([each.motion.start.x_m for each in things])
    centre_m = np.array([part.centre_m for part in parts]).reshape(-1, 3)
    centre_m[:, 0] += np.sin(phase_rad)[thing] * np.array([part.swing_m for part in parts])
    return Solids(
        form=np.array([part.form for part in parts]),
        centre_m=apply(world_from_thing[thing], centre_m[:, None])[:, 0],
        half_m=np.array([part.size_lwh_m for part in parts]).reshape(-1, 3) / 2,
        heading_rad=yaw_of(world_from_thing)[thing],
        material=np.array([MATERIAL_NUMBER[part.material] for part in parts], dtype=np.int64),
        thing=thing,
    )
