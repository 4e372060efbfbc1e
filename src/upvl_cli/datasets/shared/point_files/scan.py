"""What a file of points gives, whatever its format: named columns made into one sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools

MOST_M = 1e4  # a LiDAR sees a few hundred metres; farther is no place but a damaged number
MOST_BYTES = 1 << 30  # of one sweep, unpacked; a million points of a hundred bytes are a tenth of it
NO_RETURN = "points without a return (not a number)"
AT_ORIGIN = "points without a return (0, 0, 0)"

# Spellings of drivers and tools: ROS drivers, PCL, CloudCompare (`scalar_`), SDKs of makers, data sets.
_XYZ = (("x", "x_m"), ("y", "y_m"), ("z", "z_m"))
_INTENSITY = (
    "intensity", "intensities", "reflectance", "reflectivity", "remission", "i", "refl",
)  # fmt: skip
_RING = ("ring", "ring_id", "channel", "laser_id", "laser_number", "beam", "row", "line")
_TIME = (
    "time_offset_ns", "offset_time", "time_offset", "t", "time", "timestamp", "time_stamp", "stamp", "gps_time",
    "gpstime", "offset_ns",
)  # fmt: skip
_SENSOR = ("sensor", "sensor_id", "lidar", "lidar_id")
_MOST_RING = 255


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """The n points of one file, as it holds them: no scale and no unit is changed but that of the places.

    Attributes:
        xyz_m: (n, 3) float32 places in the axes of the file; finite, without rows that say "no return".
        intensity: (n,) in the type and on the scale of the file; None where it has none.
        ring: (n,) number of the laser; None where it has none.
        sensor: (n,) number of the LiDAR; None where it has none.
        time: (n,) time of each point in the unit of the file; None where it has none.
        layout: What the file was recognised as, for people: "float32 x, y, z, intensity".
        skipped: How many rows were left out, by reason.
    """

    xyz_m: Array
    intensity: Array | None
    ring: Array | None
    sensor: Array | None
    time: Array | None
    layout: str
    skipped: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.xyz_m)


def column_names(columns: int, last: Sequence[Array]) -> tuple[str, ...]:
    """Return names for the columns of a table that has none.

    Args:
        columns: How many there are: x, y, z, intensity, then whatever else the sensor gives.
        last: The columns from the fifth on; small whole numbers are rings, the next other one is time.
    """
    names = ["x", "y", "z", "intensity"][:columns]
    for values in last:
        is_ring = bool(len(values)) and bool(_is_count(values, _MOST_RING).all())
        name = "ring" if is_ring else "time"
        names.append(name if name not in names else f"column {len(names) + 1}")
    return tuple(names)


def scan_points(columns: Mapping[str, Array], layout: str, where: str) -> ScanPoints:
    """Return the sweep of named columns.

    Args:
        columns: (n,) numbers by name, in any spelling that `find` knows; others are ignored.
        layout: What the file is, for people.
        where: The file, for messages.

    Raises:
        BadInput: There is no x, y or z, or a place is farther away than a LiDAR sees.
    """
    layout = " ".join(layout.split())  # names in damaged files may hold anything
    by_name: dict[str, Array] = {}
    for name, values in columns.items():
        by_name.setdefault(name.strip().lower().removeprefix("scalar_"), values)
    places = [find(by_name, names) for names in _XYZ]
    if any(place is None for place in places):
        found = ", ".join(" ".join(str(name)[:40].split()) for name in list(columns)[:20]) or "none"
        raise BadInput(f"{where} ({layout}) has the columns {found}; expected x, y and z among them")
    with np.errstate(over="ignore", invalid="ignore"):
        xyz_m = np.stack([np.asarray(place).astype(np.float32) for place in places], axis=1)
        is_finite = np.isfinite(xyz_m).all(axis=1)
        is_kept = is_finite & (xyz_m != 0).any(axis=1)
    skipped = {NO_RETURN: int((~is_finite).sum()), AT_ORIGIN: int((is_finite & ~is_kept).sum())}
    if not is_kept.all():
        xyz_m = xyz_m[is_kept]
        by_name = {name: np.asarray(values)[is_kept] for name, values in by_name.items()}
    far = np.count_nonzero(np.abs(xyz_m).max(axis=1) > MOST_M) if len(xyz_m) else 0
    if far:
        raise BadInput(
            f"{where}: {far} of {len(xyz_m)} points are more than {MOST_M / 1000:g} km away, which no LiDAR sees "
            f"(read as {layout}); copy it again, or remove it to skip it"
        )
    return ScanPoints(
        xyz_m=xyz_m,
        intensity=_finite(find(by_name, _INTENSITY)),
        ring=_unsigned(find(by_name, _RING), 65535),
        sensor=_unsigned(find(by_name, _SENSOR), 255),
        time=_finite(find(by_name, _TIME)),
        layout=layout,
        skipped={reason: count for reason, count in skipped.items() if count},
    )


def find(by_name: Mapping[str, Array], names: Sequence[str]) -> Array | None:
    """Return the first column that has one of these names."""
    return next((by_name[name] for name in names if name in by_name), None)


def _finite(values: Array | None) -> Array | None:
    if values is None or np.asarray(values).dtype.kind != "f":
        return values
    is_finite = np.isfinite(values)
    return values if is_finite.all() else np.where(is_finite, values, 0)


def _unsigned(values: Array | None, most: int) -> Array | None:
    """Return whole numbers from 0 to `most`; None where the column holds anything else."""
    if values is None:
        return None
    values = np.asarray(values)
    return values.astype(np.uint16) if _is_count(values, most).all() else None


def _is_count(values: Array, most: int) -> Bools:
    with np.errstate(invalid="ignore"):
        return np.asarray((values >= 0) & (values <= most) & (values == np.floor(values)))
