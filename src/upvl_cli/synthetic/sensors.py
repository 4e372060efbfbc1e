"""Sensor presets of the made-up city: the LiDARs of well-known cars, and how often each gives a sweep.

Mounts are in ego axes: x ahead, y left, z up, the origin on the ground below the middle of the rear axle. What is
seen of the car that carries them is not made up: each mount looks over its own roof.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from upvl_cli.synthetic.config import SensorName
from upvl_cli.synthetic.mesh import Triple
from upvl_cli.types import Floats

ScanOrder = Literal["columns", "rows", "flash"]


@dataclass(frozen=True, eq=False)
class Lidar:
    """One LiDAR: a grid of azimuths and elevations seen from one place.

    Attributes:
        mount_m: Its place in ego axes.
        azimuth_rad: (c,) azimuths of its columns, counter-clockwise from ahead; measured in this order where it spins.
        elevation_rad: (r,) elevations of its beams.
        reach_m: What is further away is not measured.
        order: "columns" spins, all beams of a column at once; "rows" measures line after line; "flash" measures
            all at the time of the frame.
    """

    mount_m: Triple
    azimuth_rad: Floats
    elevation_rad: Floats
    reach_m: float
    order: ScanOrder = "columns"

    @property
    def moments(self) -> int:
        """How many times there are at which it measures."""
        return {"columns": len(self.azimuth_rad), "rows": len(self.elevation_rad), "flash": 1}[self.order]


@dataclass(frozen=True, eq=False)
class SensorPreset:
    """The LiDARs of a car.

    Attributes:
        lidars: The main one first. Those that measure over time have as many columns, or as many rows.
        rate_hz: Sweeps a second that the drive has.
        scan_s: How long one sweep takes; at the middle of it the mirror looks ahead.
        range_noise_m: Standard deviation of ranges.
        far_dropout: Share of returns lost at the end of the reach.
        has_intensity: Whether intensities are told; else they are 0.
    """

    lidars: tuple[Lidar, ...]
    rate_hz: int
    scan_s: float
    range_noise_m: float
    far_dropout: float = 0.2
    has_intensity: bool = True

    @property
    def reach_m(self) -> float:
        """The longest reach."""
        return max(lidar.reach_m for lidar in self.lidars)

    @property
    def spins(self) -> bool:
        """Whether the main one turns, so that it looks at each side at another time."""
        return self.lidars[0].order == "columns"


def around(columns: int, start: float = 0.0) -> Floats:
    """(columns,) azimuths of one clockwise turn that begins behind the car, or a share of a turn later."""
    return np.asarray(np.pi - (np.arange(columns) + 0.5) * (2 * np.pi / columns) - 2 * np.pi * start)


def _deg(*parts: ArrayLike) -> Floats:
    """Elevations in degrees as radians, from parts."""
    degrees = [np.atleast_1d(np.asarray(part, dtype=np.float64)) for part in parts]
    return np.asarray(np.deg2rad(np.concatenate(degrees)))


def _short(mount_m: Triple, yaw_rad: float) -> Lidar:
    """One of the four of short range around the Waymo car (20 m, Sun et al., CVPR 2020, table 2)."""
    azimuth = yaw_rad + np.deg2rad(np.linspace(-75, 75, 151))
    return Lidar(mount_m, azimuth, np.deg2rad(np.linspace(-45, 15, 21)), 20.0, "flash")


# 64 beams as on the Waymo car, closest around the horizon: Sun et al., CVPR 2020, section 3 (-17.6 to 2.4 degrees).
_WAYMO = SensorPreset(
    lidars=(
        Lidar((1.4, 0.0, 2.1), around(2500), _deg(np.linspace(-17.6, -7.2, 24), np.linspace(-6.9, 2.4, 40)), 80.0),
        _short((3.6, 0.0, 0.7), 0.0),
        _short((1.8, 0.95, 0.9), np.pi / 2),
        _short((1.8, -0.95, 0.9), -np.pi / 2),
        _short((-0.9, 0.0, 0.9), np.pi),
    ),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.015,
)  # fmt: skip

# Velodyne HDL-64E S2, user's manual: upper block 2.0 to -8.33 degrees every 1/3, lower one -8.83 to -24.33 every
# 1/2; 120 m; below 2 cm. 0.1728 degrees a column at 10 Hz; 1.73 m above the road: Geiger et al., IJRR 2013.
_KITTI = SensorPreset(
    lidars=(
        Lidar((0.8, 0.0, 1.73), around(2083), _deg(2 - np.arange(32) / 3, -8.83 - np.arange(32) / 2), 120.0),
    ),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.02,
)

# Velodyne VLP-32C, user's manual: 32 uneven elevations (each found again in the sweep of an Argoverse 2 log,
# grouped by laser_number, to 0.01 degrees); 0.2 degrees a column at 10 Hz; 200 m; 3 cm.
VLP_32C_DEG = (
    -25.0, -15.639, -11.31, -8.843, -7.254, -6.148, -5.333, -4.667, -4.0, -3.667, -3.333, -3.0, -2.667, -2.333,
    -2.0, -1.667, -1.333, -1.0, -0.667, -0.333, 0.0, 0.333, 0.667, 1.0, 1.333, 1.667, 2.333, 3.333, 4.667, 7.0,
    10.333, 15.0,
)  # fmt: skip
# Wilson et al., Argoverse 2, NeurIPS Datasets 2021: one upright above one upside down, half a turn out of phase.
# Heights: 1.64 and 1.57 m above the rear axle in that log's sweep, its ground 0.33 m below.
_TWIN32 = SensorPreset(
    lidars=(
        Lidar((1.35, 0.0, 1.97), around(1800), _deg(VLP_32C_DEG), 200.0),
        Lidar((1.35, 0.0, 1.90), around(1800, start=0.5), -_deg(VLP_32C_DEG), 200.0),
    ),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.02,
)

# Velodyne HDL-32E, user's manual: 10.67 to -30.67 degrees every 4/3, 100 m, 2 cm. nuScenes (Caesar et al., CVPR
# 2020) turns it at 20 Hz, 0.94 m before the rear axle and 1.84 m high; 34 688 points a sweep are 1 084 columns.
_HDL_32E = Lidar((0.94, 0.0, 1.84), around(1084), _deg(10.67 - np.arange(32) * 4 / 3), 100.0)
_HDL32_20HZ = SensorPreset(lidars=(_HDL_32E,), rate_hz=20, scan_s=0.05, range_noise_m=0.02)
# nuScenes' key frames, which alone have labels.
_HDL32_2HZ = SensorPreset(lidars=(_HDL_32E,), rate_hz=2, scan_s=0.05, range_noise_m=0.02)

# Hesai Pandar40P, user's manual: 15 to -25 degrees, every 1/3 from 2 to -6; 0.2 degrees a column at 10 Hz;
# 200 m; 2 cm. Height as on nuPlan's cars (some 1.9 m).
_BEAMS40 = SensorPreset(
    lidars=(
        Lidar(
            (1.2, 0.0, 1.9),
            around(1800),
            _deg([15, 11, 8, 5, 3], 2 - np.arange(25) / 3, -np.arange(7.0, 15.0), [-19, -25]),
            200.0,
        ),
    ),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.02,
)

# Velodyne VLP-16, user's manual: -15 to 15 degrees every 2; 0.2 degrees a column at 10 Hz; 100 m; 3 cm.
_BEAMS16 = SensorPreset(
    lidars=(Lidar((1.0, 0.0, 1.8), around(1800), _deg(np.linspace(-15, 15, 16)), 100.0),),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.02,
)

# Lyft Level 5 perception (2019): measured on its released sweeps: some 62 000 points a sweep to 200 m, five a
# second, no intensity, 2.1 m high, elevations -25 to 3 degrees some 0.3 apart above and 0.5 below -11.
_LYFT_5HZ = SensorPreset(
    lidars=(
        Lidar((1.2, 0.0, 2.1), around(1250), _deg(np.linspace(3, -10.8, 44), np.linspace(-11.5, -25, 20)), 200.0),
    ),
    rate_hz=5,
    scan_s=0.1,
    range_noise_m=0.02,
    has_intensity=False,
)  # fmt: skip

# RoboSense RS-LiDAR-M1, data sheet: 120 by 25 degrees ahead, 0.2 by 0.2, 10 Hz, 200 m, 3 cm; line after line from
# the top (the true mirror draws five fields side by side at once).
_SOLID_STATE = SensorPreset(
    lidars=(
        Lidar(
            (1.7, 0.0, 1.6),
            np.deg2rad(60 - 0.2 * (np.arange(600) + 0.5)),
            _deg(12.5 - 0.2 * np.arange(126)),
            200.0,
            "rows",
        ),
    ),
    rate_hz=10,
    scan_s=0.1,
    range_noise_m=0.03,
)

SENSORS: Mapping[SensorName, SensorPreset] = MappingProxyType(
    {
        "waymo": _WAYMO,
        "kitti": _KITTI,
        "twin32": _TWIN32,
        "hdl32_20hz": _HDL32_20HZ,
        "hdl32_2hz": _HDL32_2HZ,
        "beams40": _BEAMS40,
        "beams16": _BEAMS16,
        "lyft_5hz": _LYFT_5HZ,
        "solid_state": _SOLID_STATE,
    }
)
