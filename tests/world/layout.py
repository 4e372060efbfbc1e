"""The made-up street itself: which things there are, how they look, where they stand and how they move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from world.scene import BOX, CYLINDER, ELLIPSOID, Ground, Motion, Part, Pose, Scene, Thing

# Two lanes and two rows of parked cars between kerbs, pavements, lawns. The road falls 1.5 % to its gutters
# and the street climbs 1 %, as real ones do: its ground is no plane.
GROUND = Ground(
    y_m=(-200.0, -8.6, -5.23, -5.2, -0.07, 0.07, 5.2, 5.23, 8.6, 200.0),
    z_m=(0.11, 0.11, 0.042, -0.078, 0.0, 0.0, -0.078, 0.042, 0.11, 0.11),
    materials=("grass", "pavement", "kerb", "asphalt", "marking", "asphalt", "kerb", "pavement", "grass"),
    grade=0.01,
)
LANE_Y_M, PARKED_Y_M, KERB_Y_M, FRONT_Y_M = 1.65, 4.2, 5.2, 9.5
SLACK_M = 0.04  # twice the range noise: a label holds nearly all points of the surface below it
AHEAD, BACK = 0.0, np.pi

Size = tuple[float, float, float]
# Blocks of a body: from and to along the length (0 is the rear), from and to in height, width; then the
# material, "" for the paint of the one car.
Block = tuple[float, float, float, float, float, str]
CAR: tuple[Block, ...] = (
    (0, 1, 0.15, 0.6, 1, ""),
    (0.12, 0.7, 0.6, 0.93, 0.84, "glass"),
    (0.14, 0.68, 0.93, 1, 0.82, ""),
)
VAN: tuple[Block, ...] = ((0, 1, 0.12, 0.5, 1, ""), (0, 0.82, 0.5, 1, 0.96, ""))
TRUCK: tuple[Block, ...] = (
    (0.8, 1, 0.12, 0.8, 0.96, ""),
    (0, 0.78, 0.3, 1, 1, "white"),
    (0, 0.8, 0.18, 0.3, 0.5, "steel"),
)
BUS: tuple[Block, ...] = (
    (0, 1, 0.1, 0.45, 1, ""),
    (0.01, 0.99, 0.45, 0.8, 0.98, "glass"),
    (0, 1, 0.8, 1, 1, ""),
)


def vehicle(kind: str, size_lwh_m: Size, blocks: tuple[Block, ...], paint: str, motion: Motion) -> Thing:
    """Return a body of blocks on four wheels."""
    length, width, height = size_lwh_m[0] - 2 * SLACK_M, size_lwh_m[1] - 2 * SLACK_M, size_lwh_m[2] - SLACK_M
    parts = [
        Part(
            BOX,
            ((rear + front - 1) / 2 * length, 0.0, (low + high) / 2 * height),
            ((front - rear) * length, wide * width, (high - low) * height),
            material or paint,
        )
        for rear, front, low, high, wide, material in blocks
    ]
    wheel_m = 0.22 * height + 0.35
    for x_m in (-0.31 * length, 0.31 * length):
        for y_m in (-width / 2 + 0.13, width / 2 - 0.13):
            parts.append(Part(ELLIPSOID, (x_m, y_m, wheel_m / 2), (wheel_m, 0.26, wheel_m), "rubber"))
    return Thing(kind, size_lwh_m, motion, tuple(parts))


def walker(height_m: float, coat: str, motion: Motion) -> Thing:
    """Return a person whose legs and arms swing where they walk."""
    swing_m = 0.15 if motion.speed_mps else 0.0
    leg_m, arm_m = 0.48 * height_m, 0.36 * height_m
    parts = [
        Part(CYLINDER, (0, 0.1, leg_m / 2), (0.16, 0.16, leg_m), "denim", swing_m),
        Part(CYLINDER, (0, -0.1, leg_m / 2), (0.16, 0.16, leg_m), "denim", -swing_m),
        Part(CYLINDER, (0, 0.26, 0.62 * height_m), (0.1, 0.1, arm_m), coat, -0.8 * swing_m),
        Part(CYLINDER, (0, -0.26, 0.62 * height_m), (0.1, 0.1, arm_m), coat, 0.8 * swing_m),
        Part(CYLINDER, (0, 0, 0.65 * height_m), (0.26, 0.42, 0.36 * height_m), coat),
        Part(ELLIPSOID, (0, 0, 0.92 * height_m), (0.22, 0.18, 0.16 * height_m), "skin"),
    ]
    return Thing("Pedestrian", (0.54, 0.7, height_m + SLACK_M), motion, tuple(parts))


def cyclist(coat: str, motion: Motion) -> Thing:
    """Return a rider on a bicycle."""
    parts = [
        Part(ELLIPSOID, (0.52, 0, 0.34), (0.68, 0.08, 0.68), "rubber"),
        Part(ELLIPSOID, (-0.52, 0, 0.34), (0.68, 0.08, 0.68), "rubber"),
        Part(BOX, (-0.02, 0, 0.62), (0.8, 0.07, 0.36), "red"),
        Part(CYLINDER, (0.42, 0, 0.98), (0.08, 0.5, 0.08), "steel"),
        Part(CYLINDER, (0.02, 0.12, 0.62), (0.18, 0.15, 0.7), "denim", 0.08),
        Part(CYLINDER, (0.02, -0.12, 0.62), (0.18, 0.15, 0.7), "denim", -0.08),
        Part(ELLIPSOID, (0.05, 0, 1.2), (0.45, 0.44, 0.72), coat),
        Part(ELLIPSOID, (0.15, 0, 1.62), (0.24, 0.19, 0.28), "skin"),
    ]
    return Thing("Cyclist", (1.8, 0.6, 1.8), motion, tuple(parts))


def _still(x_m: float, y_m: float, *parts: Part) -> Thing:
    """Return a thing without label."""
    return Thing("", (0.0, 0.0, 0.0), Motion(Pose(x_m, y_m, AHEAD)), parts)


def _pole(x_m: float, y_m: float) -> Thing:
    return _still(x_m, y_m, Part(CYLINDER, (0, 0, 3.0), (0.16, 0.16, 6.0), "steel"))


def _tree(x_m: float, y_m: float, crown_m: float) -> Thing:
    trunk = Part(CYLINDER, (0, 0, 1.5), (0.3, 0.3, 3.0), "bark")
    crown = Part(ELLIPSOID, (0, 0, 2.4 + crown_m / 2), (crown_m, crown_m, crown_m), "leaves")
    return _still(x_m, y_m, trunk, crown)


def _building(x_m: float, y_m: float, size_lwh_m: Size, material: str) -> Thing:
    length, width, height = size_lwh_m
    # A metre below the ground, because the street climbs along the front.
    return _still(x_m, y_m, Part(BOX, (0, 0, height / 2 - 0.5), (length, width, height + 1), material))


def _fronts(rng: np.random.Generator, side: int) -> Iterator[Thing]:
    """Yield the houses of one side, with a wall or a hedge between each two of them."""
    x_m = -60.0
    while x_m < 120:
        length, gap, height = rng.uniform(11, 19), rng.uniform(3, 6), rng.uniform(6, 11)
        front_m = side * (FRONT_Y_M + rng.uniform(0, 0.8))
        material = str(rng.choice(["brick", "plaster", "concrete"]))
        yield _building(x_m + length / 2, front_m + side * 5, (length, 10, height), material)
        middle_m = x_m + length + gap / 2
        if rng.random() < 0.5:
            yield _building(middle_m, side * (FRONT_Y_M + 1), (gap, 0.25, 2.0), "brick")
        else:
            bush = Part(ELLIPSOID, (0, 0, 0.6), (gap - 0.6, 1.3, 1.6), "leaves")
            yield _still(middle_m, side * (FRONT_Y_M + 0.3), bush)
        x_m += length + gap


def _roadside(rng: np.random.Generator, side: int) -> Iterator[Thing]:
    """Yield the poles and trees of one side, by turns."""
    for place, x_m in enumerate(np.arange(-45.0 + 5 * side, 110, 11)):
        if place % 2:
            yield _pole(x_m, side * (KERB_Y_M + 0.45))
        else:
            yield _tree(x_m + rng.uniform(-1, 1), side * (KERB_Y_M + 0.6), rng.uniform(2.6, 3.6))


def _parked(rng: np.random.Generator, side: int) -> Iterator[Thing]:
    """Yield the parked cars of one side, with free places and room for the walker who crosses."""
    for x_m in np.arange(-40.0 + 2 * side, 90, 6.2):
        van, free = rng.random() < 0.25, rng.random() < 0.3
        size = (
            (5.3, 1.9, 2.15)
            if van
            else (rng.uniform(4.0, 4.7), rng.uniform(1.74, 1.86), rng.uniform(1.45, 1.6))
        )
        paint = str(rng.choice(["red", "white", "blue", "silver", "black"]))
        heading_rad = rng.normal(0, 0.01) + (AHEAD if side < 0 else BACK)
        pose = Pose(x_m + rng.uniform(-0.3, 0.3), side * (PARKED_Y_M + rng.uniform(-0.03, 0.03)), heading_rad)
        if not free and not 22 < x_m < 31:
            yield vehicle("Car", size, VAN if van else CAR, paint, Motion(pose))


def _traffic(rng: np.random.Generator) -> Iterator[Thing]:
    """Yield what drives and rides."""

    def motion(x_m: float, y_m: float, heading_rad: float, speed_mps: float) -> Motion:
        pose = Pose(x_m + rng.uniform(-1.5, 1.5), y_m, heading_rad)
        return Motion(pose, speed_mps=speed_mps * rng.uniform(0.93, 1.07))

    yield vehicle("Car", (4.5, 1.82, 1.5), CAR, "silver", motion(36, -LANE_Y_M, AHEAD, 8.5))
    yield vehicle(
        "Truck", (7.5, 2.4, 3.1), TRUCK, "blue", replace(motion(-20, -LANE_Y_M, AHEAD, 6.5), brake_mps2=1.1)
    )
    yield vehicle("Car", (4.2, 1.78, 1.55), CAR, "red", motion(30, LANE_Y_M, BACK, 10.0))
    yield vehicle(
        "Bus", (11.5, 2.5, 3.1), BUS, "yellow", replace(motion(58, LANE_Y_M, BACK, 7.0), brake_mps2=1.2)
    )
    yield vehicle("Car", (4.6, 1.85, 1.5), CAR, "white", motion(-25, LANE_Y_M, BACK, 9.0))
    yield cyclist("yellow", replace(motion(13, -2.8, AHEAD, 4.5), aside_m=0.3, aside_s=2.0))


def _walkers(rng: np.random.Generator) -> Iterator[Thing]:
    """Yield who walks: one across the road, the others on the pavements, and one who waits."""
    crossing = Motion(Pose(26.5, rng.uniform(-4.6, -4.3), np.pi / 2), speed_mps=rng.uniform(1.2, 1.5))
    yield walker(1.78, "red", crossing)
    yield walker(1.72, "white", Motion(Pose(rng.uniform(14, 17), -7.9, rng.uniform(-2, 2))))
    ways = ((8.0, -6.9, AHEAD), (19.0, 7.5, BACK), (19.4, 6.5, BACK), (34.0, 7.6, AHEAD), (-12.0, -7.2, BACK))
    for x_m, y_m, heading_rad in ways:
        pose = Pose(x_m + rng.uniform(-0.8, 0.8), y_m, heading_rad + rng.normal(0, 0.01))
        coat = str(rng.choice(["blue", "black", "red", "white"]))
        yield walker(rng.uniform(1.55, 1.9), coat, Motion(pose, speed_mps=rng.uniform(1.1, 1.6)))


def street(rng: np.random.Generator) -> Scene:
    """Return a street whose details chance decides: all brake for a walker who crosses, and nobody collides.

    The walker is across after 8 s; what is after that is not thought through.

    Args:
        rng: Source of all chance.
    """
    hidden = Motion(Pose(20.0, 22.0, AHEAD))  # in the yard behind the houses
    things = (
        *_traffic(rng),
        *_walkers(rng),
        *_parked(rng, -1),
        *_parked(rng, 1),
        vehicle("Car", (4.4, 1.8, 1.5), CAR, "black", hidden),
        *_roadside(rng, -1),
        *_roadside(rng, 1),
        *_fronts(rng, -1),
        *_fronts(rng, 1),
        _building(125.0, 0.0, (6.0, 40.0, 14.0), "plaster"),
    )
    ego = Motion(Pose(0.0, -LANE_Y_M, AHEAD), speed_mps=8.0, brake_mps2=1.5, aside_m=0.4, aside_s=2.5)
    return Scene(GROUND, things, ego)
