"""What was seen of one object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upvl_cli.types import Boxes, Floats


@dataclass(frozen=True)
class Sightings:
    """What was seen of one object, frame by frame, in world axes.

    Attributes:
        time_s: (T,) ascending time of each frame.
        xyz_m: T arrays (n, 3) of its points; some can be empty.
        height_m: T arrays (n,) of their heights over the ground.
        boxes: T boxes: place and size of what was seen in each frame.
        velocity_mps: (T, 3) smooth velocity.
        sensor_xy_m: (T, 2) position of the sensor.
        sensor_heading_rad: (T,) heading of the car that carries it.
    """

    time_s: Floats
    xyz_m: Sequence[Floats]
    height_m: Sequence[Floats]
    boxes: Boxes
    velocity_mps: Floats
    sensor_xy_m: Floats
    sensor_heading_rad: Floats
