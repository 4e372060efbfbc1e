"""How a LiDAR turns: its field of view, its sense, the steps between its columns."""

from __future__ import annotations

from typing import Literal

import numpy as np

from upvl_cli.types import Array, Floats

Sense = Literal["clockwise", "counter-clockwise", "unknown"]

_BIN_DEG = 1.0
_FULL_GAP_DEG = 30.0  # a smaller gap hides behind a part of the car
_STRAY_SHARE = 0.002  # of the points lie in degrees that are not counted as seen
_PARTS = 36  # of a turn
_MIN_ONE_WAY = 0.9  # of the steps between the parts go one way round
_MIN_TURN_DEG = 60.0  # less is no turn
_MAX_STEP_DEG = 5.0  # a longer one is a gap of the scene


def azimuths_deg(xyz_m: Array, origin_m: Array) -> Floats:
    """Return (n,) azimuths of points in degrees, counter-clockwise from x, as seen from a place.

    Args:
        xyz_m: (n, 3) points.
        origin_m: (3,) the place, or (n, 3) one for each point.
    """
    ray = np.asarray(xyz_m, dtype=np.float64) - origin_m
    return np.asarray(np.degrees(np.arctan2(ray[:, 1], ray[:, 0])))


def field_of_view_deg(azimuth_deg: Floats) -> tuple[float, float]:
    """Return the width of what a LiDAR sees, 360 for a full circle, and the azimuth of its middle.

    Args:
        azimuth_deg: (n,) azimuths of its points.
    """
    if not len(azimuth_deg):
        return 0.0, 0.0
    bins = ((azimuth_deg + 180) / _BIN_DEG).astype(np.int64) % int(360 / _BIN_DEG)
    count = np.bincount(bins, minlength=int(360 / _BIN_DEG))
    seen = np.flatnonzero(count > _STRAY_SHARE * len(bins) / len(count))
    gaps = (np.roll(seen, -1) - seen) % len(count)
    widest = int(np.argmax(gaps))
    gap_deg = (gaps[widest] - 1) * _BIN_DEG if len(seen) > 1 else 360 - _BIN_DEG
    if gap_deg < _FULL_GAP_DEG:
        return 360.0, 0.0
    width = 360 - gap_deg
    middle = float(seen[(widest + 1) % len(seen)]) * _BIN_DEG + width / 2 - 180
    return width, float((middle + 180) % 360 - 180)


def sense_of_turn(azimuth_deg: Floats, time_ns: Array) -> Sense:
    """Return which way round a LiDAR turns, seen from above.

    Args:
        azimuth_deg: (n,) azimuths of its points.
        time_ns: (n,) when each was measured, or its place in a file that is written column by column.
    """
    if len(azimuth_deg) < 2 * _PARTS or np.ptp(time_ns) == 0:
        return "unknown"
    order = np.argsort(time_ns, kind="stable")
    parts = np.array_split(np.exp(1j * np.radians(azimuth_deg[order])), _PARTS)
    mean = np.array([part.mean() for part in parts])
    if np.median(np.abs(mean)) < _MIN_ONE_WAY:  # a part of the time sees all round: no turn
        return "unknown"
    step = np.degrees(np.angle(mean[1:] / mean[:-1]))
    way = np.sign(np.median(step))
    if (np.sign(step) == way).mean() < _MIN_ONE_WAY or abs(step.sum()) < _MIN_TURN_DEG:
        return "unknown"
    return "counter-clockwise" if way > 0 else "clockwise"


def column_step_deg(azimuth_deg: Floats, elevation_deg: Floats, beams_deg: Floats) -> float:
    """Return the usual step in azimuth between neighbouring points of a beam; NaN without beams.

    Args:
        azimuth_deg: (n,) azimuths of the points of one sweep.
        elevation_deg: (n,) their elevations.
        beams_deg: (b,) elevations of the beams, ascending.
    """
    if len(beams_deg) < 2 or len(azimuth_deg) < 2:
        return float("nan")
    middle = (beams_deg[1:] + beams_deg[:-1]) / 2
    beam = np.searchsorted(middle, elevation_deg)
    order = np.lexsort((azimuth_deg, beam))
    step = np.diff(azimuth_deg[order])
    inside = (np.diff(beam[order]) == 0) & (step > 1e-3) & (step < _MAX_STEP_DEG)
    return float(np.median(step[inside])) if inside.any() else float("nan")
