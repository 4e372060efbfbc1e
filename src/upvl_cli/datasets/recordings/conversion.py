"""From a sensor's own units to those of a drive: intensity 0 to 1, points in ego axes, times after the sweep's.

Both scales are read off a sample of the drive, once, so that all of its sweeps have the same: a file whose brightest
return is weak must not be scaled up.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.parquet.writer import PointsRow
from upvl_cli.datasets.recordings.recording import LidarScan, RecordedSweep
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array

CAR_POINTS = "points on the car itself"
# Whole ranges of sensors: 0 to 1, and 8, 10, 12, 14 and 16 bits.
_INTENSITY_MAX = (1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0)
_TIME_UNITS_NS = (1e9, 1e6, 1e3, 1.0)
_SWEEP_S = (0.002, 2.0)  # how long a sweep takes: two units cannot both be right
_OTHER_CLOCK_NS = 10e9
_MOST_OFFSET_NS = 2**31 - 1


@dataclass(frozen=True)
class LidarUnits:
    """The units of one LiDAR.

    Attributes:
        intensity_max: What 1 stands for; 0 where it gives no intensity.
        time_unit_ns: Nanoseconds of one unit of its point times; 0 where it gives none.
        layouts: What its sweeps were recognised as; more than one where they differ.
    """

    intensity_max: float
    time_unit_ns: float
    layouts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Conversion:
    """How the sweeps of one drive are converted.

    Attributes:
        units: Units of each LiDAR by its number.
        car_m: x from and to, y from and to, of the car in ego axes, whose points are dropped; or None.
        has_sensor: Whether points say which LiDAR saw them.
    """

    units: Mapping[int, LidarUnits]
    car_m: tuple[float, float, float, float] | None
    has_sensor: bool

    @property
    def columns(self) -> tuple[str, ...]:
        """The optional columns of the drive."""
        names = ["intensity"] if any(units.intensity_max for units in self.units.values()) else []
        names += ["sensor"] if self.has_sensor or len(self.units) > 1 else []
        return (*names, *(["time_offset_ns"] if self.has_times else []))

    @property
    def has_times(self) -> bool:
        """Whether points have times of their own."""
        return any(units.time_unit_ns for units in self.units.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what was found, for people."""
        found = []
        for lidar, units in sorted(self.units.items()):
            name = f"LiDAR {lidar}: " if len(self.units) > 1 else ""
            scale = f"intensity 0 to {units.intensity_max:g}" if units.intensity_max else "no intensity"
            words = {1e9: "seconds", 1e6: "milliseconds", 1e3: "microseconds", 1.0: "nanoseconds"}
            time = (
                f"times of points in {words[units.time_unit_ns]}"
                if units.time_unit_ns
                else "no times of points"
            )
            found.append(f"{name}{' or '.join(units.layouts)}: {scale}, {time}")
        return tuple(found)

    def row(self, sweep: RecordedSweep, skipped: Counter[str]) -> PointsRow:
        """Return a sweep in the units of a drive; what is dropped is counted."""
        parts = [self._part(sweep, scan, skipped) for scan in sweep.scans]
        xyz = np.concatenate([xyz for xyz, _ in parts])
        columns = {name: np.concatenate([values[name] for _, values in parts]) for name in self.columns}
        if self.car_m is not None:
            x_from, x_to, y_from, y_to = self.car_m
            x, y = xyz[:, 0], xyz[:, 1]
            outside = ~((x >= x_from) & (x <= x_to) & (y >= y_from) & (y <= y_to))
            skipped[CAR_POINTS] += int((~outside).sum())
            xyz, columns = xyz[outside], {name: values[outside] for name, values in columns.items()}
        return PointsRow(sweep.frame, sweep.time_ns, sweep.world_from_ego, xyz, columns)

    def _part(
        self, sweep: RecordedSweep, scan: LidarScan, skipped: Counter[str]
    ) -> tuple[Array, dict[str, Array]]:
        points, total = scan.points, len(scan.points)
        units = self.units.get(scan.lidar, LidarUnits(0.0, 0.0))
        skipped.update(points.skipped)
        xyz = points.xyz_m
        if not np.array_equal(scan.ego_from_lidar, np.eye(4)):
            xyz = apply(scan.ego_from_lidar, xyz).astype(np.float32)
        intensity = np.zeros(total, np.float32)
        if points.intensity is not None and units.intensity_max:
            intensity = np.clip(points.intensity.astype(np.float32) / np.float32(units.intensity_max), 0, 1)
        offset_ns = np.full(total, float(scan.time_ns - sweep.time_ns))
        if points.time is not None and units.time_unit_ns:
            offset_ns = offsets_ns(points.time, units.time_unit_ns, scan.time_ns) + offset_ns
        sensor = (
            points.sensor if self.has_sensor and points.sensor is not None else np.full(total, scan.lidar)
        )
        return xyz, {
            "intensity": intensity,
            "sensor": sensor.astype(np.uint8),
            "time_offset_ns": np.clip(offset_ns, -_MOST_OFFSET_NS, _MOST_OFFSET_NS).astype(np.int32),
        }


def measure(
    sample: Sequence[LidarScan], intensity_max: float | None, car_m: tuple[float, float, float, float] | None
) -> Conversion:
    """Return the conversion of a drive.

    Args:
        sample: Some scans of each LiDAR.
        intensity_max: The intensity that 1 stands for; None for the least whole range that holds the sample.
        car_m: See `Conversion`.
    """
    by_lidar: dict[int, list[LidarScan]] = {}
    for scan in sample:
        by_lidar.setdefault(scan.lidar, []).append(scan)
    units = {
        lidar: LidarUnits(
            _intensity_max([scan.points.intensity for scan in scans], intensity_max),
            _time_unit_ns([scan.points.time for scan in scans]),
            tuple(sorted({scan.points.layout for scan in scans})),
        )
        for lidar, scans in by_lidar.items()
    }
    has_sensor = any(scan.points.sensor is not None for scan in sample) and len(by_lidar) == 1
    return Conversion(units, car_m, has_sensor)


def _intensity_max(intensities: Sequence[Array | None], given: float | None) -> float:
    found = [values for values in intensities if values is not None]
    if not found:
        return 0.0
    if given is not None:
        return given
    most = max((float(values.max()) for values in found if len(values)), default=0.0)
    least = 255.0 if all(values.dtype == np.uint8 for values in found) else 1.0
    return next((bound for bound in _INTENSITY_MAX if bound >= max(most, least)), most)


def _time_unit_ns(times: Sequence[Array | None]) -> float:
    """Return the unit in which the points of a sweep span a time that a LiDAR takes; 0 where there is none."""
    spans = [
        float(values.max()) - float(values.min()) for values in times if values is not None and len(values)
    ]
    span = float(np.median(spans)) if spans else 0.0
    units = (unit for unit in _TIME_UNITS_NS if _SWEEP_S[0] <= span * unit / 1e9 < _SWEEP_S[1])
    return next(units, 0.0)


def offsets_ns(times: Array, unit_ns: float, time_ns: int) -> Array:
    """Return (n,) nanoseconds after a scan's time.

    Args:
        times: (n,) times of the points: since 1970, since the scan's time, or on a clock of their own.
        unit_ns: Nanoseconds of one unit.
        time_ns: Time of the scan.
    """
    if not len(times):
        return np.zeros(0)
    first = times.min()
    first_ns = float(first) * unit_ns
    since_first_ns = (times - first).astype(np.float64) * unit_ns
    if abs(first_ns - time_ns) < _OTHER_CLOCK_NS and abs(first_ns) > _OTHER_CLOCK_NS:
        # Times since 1970: subtracted as integers where they are integers, since a float64 has no more digits.
        start_ns = int(first) * int(unit_ns) - time_ns if times.dtype.kind in "iu" else first_ns - time_ns
        return np.asarray(since_first_ns + start_ns)
    return np.asarray(since_first_ns + (first_ns if abs(first_ns) < _OTHER_CLOCK_NS else 0.0))
