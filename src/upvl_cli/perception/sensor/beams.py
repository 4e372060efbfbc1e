"""How many beams a LiDAR has, and at which elevations."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from upvl_cli.types import Array, Floats

_MIN_BEAMS, _MAX_BEAMS = 4, 256
_LIMIT_DEG, _BIN_DEG = 60.0, 0.01
_WIDTHS_DEG = 0.02 * 1.3 ** np.arange(12)  # of a beam in the histogram: up to 0.36 degrees
_MIN_PROMINENCE, _MIN_SIGMAS = (
    0.3,
    5.0,
)  # of a peak: as a share of its height, and above the noise of counting
_MIN_MASS = 0.1  # of a beam, beside the beams next to it: less is stray
_ON_BEAM, _MIN_ON_BEAM = 0.25, 0.8  # of the points lie this near to a beam, in spaces between two
_MIN_ROUND_SHARE = 0.95  # of the steps of a file that is written beam by beam go one way round
_BACK_DEG = 30.0  # a step back by more begins another beam
_START_STEP_DEG = 15.0


def beams_by_order(azimuth_deg: Array, elevation_deg: Array) -> Floats | None:
    """Return the ascending elevations of the beams of a sweep that is stored beam by beam, else None.

    Args:
        azimuth_deg: (n,) azimuths in the order of the file.
        elevation_deg: (n,) elevations.
    """
    if len(azimuth_deg) < 2:
        return None
    step = (np.diff(azimuth_deg) + 180) % 360 - 180
    if np.median(step) < 0:
        azimuth_deg, step = -np.asarray(azimuth_deg), -step
    if (step > 0).mean() < _MIN_ROUND_SHARE:
        return None
    found = []
    for start in np.arange(0, 360, _START_STEP_DEG):
        around = (azimuth_deg - start) % 360
        beam = np.append(0, np.cumsum(np.diff(around) < -_BACK_DEG))
        count = np.bincount(beam)
        medians = _medians(elevation_deg, count)
        spread = float(np.median(np.abs(elevation_deg - medians[beam])))
        # The last beam goes a little beyond the start.
        medians = medians[count >= _MIN_MASS * np.median(count)]
        found.append((len(medians), spread, start, medians))
    # A start in the middle of the beams of the file cuts the first of them in two.
    _, spread, _, medians = min(found, key=lambda item: item[:3])
    elevations = np.sort(medians)
    if not _MIN_BEAMS <= len(elevations) <= _MAX_BEAMS or spread > np.median(np.diff(elevations)) / 2:
        return None
    return elevations


def _medians(values: Array, count: Array) -> Floats:
    parts = np.split(values, np.cumsum(count)[:-1])
    return np.array([np.median(part) for part in parts])


def beams_by_histogram(elevation_deg: Array) -> Floats | None:
    """Return the ascending elevations at which points gather, or None where their number depends on the scale.

    The number of peaks of a histogram under more and more smoothing stays the same as long as the smoothing is
    wider than a beam and narrower than the space between two.

    Args:
        elevation_deg: (n,) elevations of the points of one or several sweeps, from the place of the LiDAR.
    """
    inside = elevation_deg[np.abs(elevation_deg) < _LIMIT_DEG]
    edges = np.arange(-_LIMIT_DEG, _LIMIT_DEG + _BIN_DEG, _BIN_DEG)
    count = np.histogram(inside, edges)[0].astype(np.float64)
    found = [_peaks(count, width / _BIN_DEG) for width in _WIDTHS_DEG]
    best: tuple[int, int] | None = None
    first = 0
    for place in range(1, len(found) + 1):
        if place < len(found) and len(found[place]) == len(found[first]):
            continue
        length = place - first
        if (
            _MIN_BEAMS <= len(found[first]) <= _MAX_BEAMS
            and length >= 2
            and (best is None or length > best[0])
        ):
            best = length, first
        first = place
    if best is None:
        return None
    beams = edges[found[best[1]]] + _BIN_DEG / 2
    nearest = np.clip(np.searchsorted((beams[1:] + beams[:-1]) / 2, inside), 0, len(beams) - 1)
    on_beam = np.abs(inside - beams[nearest]) < _ON_BEAM * np.gradient(beams)[nearest]
    return beams if on_beam.mean() >= _MIN_ON_BEAM else None


def _peaks(count: Floats, width: float) -> Array:
    """Return the bins of the beams in a histogram that is smoothed by that many bins."""
    smooth = gaussian_filter1d(count, width)
    bins, shape = find_peaks(smooth, prominence=1e-3)
    noise = np.sqrt(smooth[bins] / (2 * np.sqrt(np.pi) * width))
    clear = (shape["prominences"] > _MIN_PROMINENCE * smooth[bins]) & (
        shape["prominences"] > _MIN_SIGMAS * noise
    )
    bins = bins[clear]
    if len(bins) < 3:
        return np.asarray(bins)
    valleys = [low + int(np.argmin(smooth[low:high])) for low, high in zip(bins[:-1], bins[1:], strict=True)]
    mass = np.add.reduceat(count, [0, *valleys])
    around = np.array([np.median(mass[max(0, place - 2) : place + 3]) for place in range(len(mass))])
    return np.asarray(bins[mass >= _MIN_MASS * around])
