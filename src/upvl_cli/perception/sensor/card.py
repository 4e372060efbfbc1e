"""The sensors of a drive as its own sweeps show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from upvl_cli.perception.sensor.coverage import CarFootprint
from upvl_cli.perception.sensor.intensity import IntensityScale
from upvl_cli.perception.sensor.turn import Sense


@dataclass(frozen=True)
class LidarCard:
    """One LiDAR.

    Attributes:
        sensor: Its number in `Points.sensor`.
        points: Points of a sweep: the fewest, the median, the most.
        beams_deg: Elevations of its beams, ascending; empty where they cannot be told.
        elevation_deg: Lowest and highest elevation of its points.
        azimuth_step_deg: Usual step between neighbouring points of a beam; None where that cannot be told.
        field_of_view_deg: Width of what it sees, 360 for a full circle.
        direction_deg: Azimuth of the middle of that, counter-clockwise from x; 0 for a full circle.
        sense: Which way round it turns, seen from above.
        origin_m: Where it sits in ego axes; None where that cannot be told.
        height_m: Its height above the road; None where that cannot be told.
        range_m: The 99.9th percentile of its ranges and the largest one.
        hidden_deg: Directions without any return, from and to.
        intensity: The scale of its intensities.
    """

    sensor: int
    points: tuple[int, int, int]
    beams_deg: tuple[float, ...]
    elevation_deg: tuple[float, float]
    azimuth_step_deg: float | None
    field_of_view_deg: float
    direction_deg: float
    sense: Sense
    origin_m: tuple[float, float, float] | None
    height_m: float | None
    range_m: tuple[float, float]
    hidden_deg: tuple[tuple[float, float], ...]
    intensity: IntensityScale

    @property
    def beam_step_deg(self) -> float | None:
        """The usual step between neighbouring beams; None where the beams cannot be told."""
        return float(np.median(np.diff(self.beams_deg))) if len(self.beams_deg) > 1 else None

    @property
    def finest_beam_step_deg(self) -> float | None:
        """The step between the beams that stand closest, a tenth of all; None where the beams cannot be told."""
        return float(np.percentile(np.diff(self.beams_deg), 10)) if len(self.beams_deg) > 1 else None

    @property
    def lines(self) -> tuple[str, ...]:
        """The card for people: a line for each part."""
        beams = "beams: cannot tell"
        if self.beams_deg:
            beams = (
                f"{len(self.beams_deg)} beams from {self.beams_deg[0]:.1f} to {self.beams_deg[-1]:.1f} degrees, "
                f"{self.finest_beam_step_deg:.2f} to {np.diff(self.beams_deg).max():.2f} apart"
            )
        step = f", columns {self.azimuth_step_deg:.2f} degrees apart" if self.azimuth_step_deg else ""
        view = "full circle"
        if self.field_of_view_deg < 360:
            view = f"{self.field_of_view_deg:.0f} degrees around {self.direction_deg:.0f}"
        height = "height above the road: cannot tell"
        if self.height_m is not None:
            height = f"{self.height_m:.2f} m above the road"
        place = "" if self.origin_m is None else " at ({:.2f}, {:.2f}, {:.2f}) m".format(*self.origin_m)
        hidden = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in self.hidden_deg)
        light = self.intensity
        steps = f", steps of {light.bits} bits" if light.bits else ""
        return (
            beams + step,
            f"{view}, turn {self.sense}",
            height + place,
            f"{self.points[1]} points a sweep ({self.points[0]} to {self.points[2]}), "
            f"to {self.range_m[0]:.0f} m (farthest {self.range_m[1]:.0f} m)",
            f"intensity {light.scale} ({light.lowest:.3g} to {light.highest:.3g}{steps})",
            *((f"nothing seen from {hidden} degrees",) if hidden else ()),
        )


@dataclass(frozen=True)
class CameraCard:
    """One camera.

    Attributes:
        name: Its name.
        size_px: Width and height of its pictures.
        field_of_view_deg: Width of its view.
        direction_deg: Azimuth of its view, counter-clockwise from x.
        points_share: Share of the points of a sweep that it sees.
        delay_s: Usual time from the sweep to its picture; None without a picture.
    """

    name: str
    size_px: tuple[int, int]
    field_of_view_deg: float
    direction_deg: float
    points_share: float
    delay_s: float | None

    @property
    def line(self) -> str:
        """The card for people."""
        delay = "no picture" if self.delay_s is None else f"{self.delay_s * 1e3:+.0f} ms after its sweep"
        return (
            f"{self.size_px[0]} x {self.size_px[1]}, {self.field_of_view_deg:.0f} degrees around "
            f"{self.direction_deg:.0f}, sees {self.points_share:.0%} of the points, {delay}"
        )


@dataclass(frozen=True)
class SensorCard:
    """All sensors of a drive.

    Attributes:
        frames: How many frames the drive has.
        rate_hz: Sweeps a second; None for a single frame.
        jitter: Standard deviation of the time between sweeps as a share of it, gaps left out.
        turn_s: Time from the first to the last point of a sweep; None where points have no times.
        road_z_m: Height of the road in ego axes, as measured.
        car: The car itself where its points are in the sweeps.
        car_drives: Whether the scene around the car changes; without that the car cannot be told.
        lidars: Its LiDARs.
        cameras: Its cameras.
    """

    frames: int
    rate_hz: float | None
    jitter: float
    turn_s: float | None
    road_z_m: float
    car: CarFootprint | None
    car_drives: bool
    lidars: tuple[LidarCard, ...]
    cameras: tuple[CameraCard, ...]

    @property
    def main_lidar(self) -> LidarCard | None:
        """The LiDAR of most points; None for a drive without points."""
        return max(self.lidars, key=lambda lidar: lidar.points[1], default=None)

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """The card for people: subject and text of each line."""
        rate = "a single frame: cannot tell the rate"
        if self.rate_hz is not None:
            rate = f"{self.rate_hz:.2f} Hz, jitter {self.jitter:.1%}"
        turn = "" if self.turn_s is None else f", points over {self.turn_s * 1e3:.0f} ms"
        car = (
            "no point of the car itself" if self.car_drives else "the car stands: cannot tell its own points"
        )
        if self.car is not None:
            (back, front), (right, left) = self.car.x_m, self.car.y_m
            car = (
                f"{self.car.points} points a sweep on the car itself, x {back:.1f} to {front:.1f}, "
                f"y {right:.1f} to {left:.1f} m"
            )
        return (
            ("sweeps", f"{self.frames} frames, {rate}{turn}"),
            ("road", f"{self.road_z_m:+.2f} m in ego axes"),
            *((f"LiDAR {lidar.sensor}", line) for lidar in self.lidars for line in lidar.lines),
            ("car", car),
            *((f"camera {camera.name}", camera.line) for camera in self.cameras),
        )

    def to_json(self) -> Mapping[str, Any]:
        """Return the card as plain numbers, texts, lists and dicts."""
        return asdict(self)
