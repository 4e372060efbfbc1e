"""Are the points of the sweeps points: finite, seen once, of one scale, and not the car itself?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.config.base import Config, setting
from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.sensor.card import SensorCard
from upvl_cli.perception.sensor.intensity import measure_intensity
from upvl_cli.types import Array, Points

_NAMED = 3  # frames that a finding names
_NEIGHBORS = 12
_SEED = 0
_LARGEST = 1e6  # a LiDAR that reaches 500 m, in millimetres: the check of units names those
_MIN_POINTS = 50  # of a sweep: of fewer nothing can be said


@dataclass(frozen=True)
class PointsCheckConfig(Config):
    """What sweeps may hold."""

    max_zero_share: float = setting("most points at the origin without a warning, as a share", ge=0, le=1)
    max_count_ratio: float = setting(
        "most points of a sweep, beside those of the sweep before it", gt=1, le=1000
    )
    max_same_m: float = setting(
        "points of two sweeps that differ by less are the same points", "m", gt=0, le=10
    )
    tiny_m: float = setting("coordinates nearer to 0, but not 0, are no measurements", "m", gt=0, le=1)
    max_wrong_share: float = setting(
        "most points that are no measurements without a fault, as a share", ge=0, le=1
    )
    surface_points: int = setting("points of a sweep around which a surface is looked for", ge=10, le=10**5)
    max_surface_ratio: float = setting(
        "a surface is thinner than this share of the distance between its points, by the median", gt=0, le=1
    )
    max_doubled_share: float = setting(
        "points of a sweep at the place of another one that are told, as a share", ge=0, le=1
    )


def check_points(sample: DriveSample, config: PointsCheckConfig) -> Iterator[Finding]:
    """Yield the findings on the points of the sweeps that are looked at.

    Args:
        sample: Part of the drive.
        config: Settings.
    """
    steps = sample.steps
    sweeps = [sample.sweep(step) for step in steps]
    counts = np.array([len(sweep) for sweep in sweeps])
    names = [sample.frames[step].index for step in steps]
    if not counts.any():
        yield Finding(
            "points", "fault", f"none in any of {len(steps)} sweeps", "", "", "", "look at the files"
        )
        return
    spread = [sample.sweep(run[0]) for run in sample.runs if len(sample.sweep(run[0]))]
    found = [
        *_empty(counts, names),
        *_not_finite(sweeps, names),
        *_zeros(spread, config),
        *_same_sweeps(sample, config),
        *_counts(sample, config),
        *_ranges(spread, config),
        *_intensities(spread),
    ]
    if not any(finding.is_fault for finding in found):
        found += _surfaces(spread, config)
    yield from found
    if all(finding.level == "ok" for finding in found):
        yield from _doubled(spread, config)
        yield Finding("points", "ok", f"{int(np.median(counts))} a sweep, finite, each sweep once")


def check_own_car(card: SensorCard) -> Iterator[Finding]:
    """Yield a warning where points of the car itself are in the sweeps.

    Args:
        card: The sensors of the drive.
    """
    if card.car is None:
        return
    (back, front), (right, left) = card.car.x_m, card.car.y_m
    text = (
        f"{card.car.points} points a sweep move as the car does, x {back:.1f} to {front:.1f}, "
        f"y {right:.1f} to {left:.1f} m"
    )
    remedy = correction(f"car_m = [{back:.1f}, {front:.1f}, {right:.1f}, {left:.1f}]")
    yield Finding("points", "warning", text, "", "", "the LiDAR sees the car that carries it", remedy)


def _empty(counts: Array, names: Sequence[int]) -> Iterator[Finding]:
    empty = np.flatnonzero(counts == 0)
    if len(empty):
        text = f"{len(empty)} of {len(counts)} sweeps have none"
        yield Finding(
            "points", "warning", text, _places([names[int(place)] for place in empty]), "", "lost sweeps", ""
        )


def _not_finite(sweeps: Sequence[Points], names: Sequence[int]) -> Iterator[Finding]:
    wrong = [int((~np.isfinite(sweep.xyz_ego_m).all(axis=1)).sum()) for sweep in sweeps]
    if any(wrong):
        where = _places([name for name, count in zip(names, wrong, strict=True) if count])
        text = f"up to {max(wrong)} of a sweep are not finite"
        cause = "rays without return were kept as NaN or infinity"
        yield Finding("points", "fault", text, where, "", cause, "write the sweeps without them")


def _zeros(sweeps: Sequence[Points], config: PointsCheckConfig) -> Iterator[Finding]:
    share = float(np.mean([(sweep.xyz_ego_m == 0).all(axis=1).mean() for sweep in sweeps])) if sweeps else 0.0
    if share > config.max_zero_share:
        text = f"{share:.1%} lie at the origin"
        cause = "rays without return were kept as zeros"
        yield Finding(
            "points", "warning", text, "", f"{len(sweeps)} sweeps", cause, "write the sweeps without them"
        )


def _same_sweeps(sample: DriveSample, config: PointsCheckConfig) -> Iterator[Finding]:
    """Yield a fault where neighbouring sweeps hold the same points."""
    same = [
        pair
        for pair in sample.pairs
        if is_same_sweep(sample.sweep(pair[0]), sample.sweep(pair[1]), config.max_same_m)
    ]
    if not same:
        return
    text = f"{len(same)} of {len(sample.pairs)} sweeps are those before them once more"
    cause = "a recorder that repeats the last sweep, or files copied under two numbers"
    where = _places([sample.frames[second].index for _, second in same])
    yield Finding("points", "fault", text, where, "equal points", cause, "leave the repeated sweeps out")


def is_same_sweep(first: Points, second: Points, max_same_m: float) -> bool:
    """Return whether two sweeps hold the same points; motion compensation may have moved them a little.

    Args:
        first: One sweep.
        second: Another one.
        max_same_m: Points without intensities are the same where they are this near, by the median.
    """
    if len(first) != len(second) or not len(first):
        return False
    if np.ptp(first.intensity) > 0:
        return bool(np.array_equal(first.intensity, second.intensity))
    return bool(np.median(np.abs(first.xyz_ego_m - second.xyz_ego_m).max(axis=1)) < max_same_m)


def _counts(sample: DriveSample, config: PointsCheckConfig) -> Iterator[Finding]:
    jumps = []
    for first, second in sample.pairs:
        few, many = sorted((len(sample.sweep(first)), len(sample.sweep(second))))
        if few > _MIN_POINTS and many > config.max_count_ratio * few:
            jumps.append(second)
    if jumps:
        text = f"their number changes by more than {config.max_count_ratio:g} times from sweep to sweep"
        where = _places([sample.frames[step].index for step in jumps])
        evidence = f"{len(jumps)} of {len(sample.pairs)} pairs"
        cause = "parts of turns, lost packets, or a LiDAR that is missing in some sweeps"
        yield Finding("points", "warning", text, where, evidence, cause, "give whole turns of all LiDARs")


def _ranges(sweeps: Sequence[Points], config: PointsCheckConfig) -> Iterator[Finding]:
    far, tiny = [], []
    for sweep in sweeps:
        size = np.abs(sweep.xyz_ego_m[np.isfinite(sweep.xyz_ego_m).all(axis=1)])
        far.append(float((size.max(axis=1, initial=0) > _LARGEST).mean()) if len(size) else 0.0)
        tiny.append(float(((size < config.tiny_m) & (size > 0)).any(axis=1).mean()) if len(size) else 0.0)
    wrong = max(float(np.mean(far)), float(np.mean(tiny))) if far else 0.0
    if wrong > config.max_wrong_share:
        text = f"{wrong:.1%} are larger than {_LARGEST:g} or smaller than {config.tiny_m:g}"
        cause = "bytes read as another type, or rows of another width"
        remedy = "state the true type and the number of columns of the files"
        yield Finding("points", "fault", text, "", f"{len(sweeps)} sweeps", cause, remedy)


def _intensities(sweeps: Sequence[Points]) -> Iterator[Finding]:
    found = measure_intensity(sweep.intensity for sweep in sweeps)
    evidence = f"{len(sweeps)} sweeps"
    if found.scale == "unknown":
        text = f"intensities from {found.lowest:.3g} to {found.highest:.3g}"
        cause = "another column was read as intensity"
        yield Finding("points", "fault", text, "", evidence, cause, "state the columns of the files")
    elif found.scale == "constant":
        text = f"all intensities are {found.highest:.3g}"
        yield Finding("points", "warning", text, "", evidence, "a column was filled with one number", "")
    elif found.full > 1:
        text = f"intensities go to {found.highest:.4g}, expected 0 to 1"
        cause = f"the files have them on the scale {found.scale}"
        yield Finding(
            "points",
            "warning",
            text,
            "",
            evidence,
            cause,
            correction(f"intensity_full = {found.full:.1f}"),
        )
    elif found.scale == "0 to 1" and found.highest <= _TWICE_DIVIDED:
        text = f"intensities go to {found.highest:.2g} only, expected 0 to 1"
        cause = "they were divided by 255 twice"
        yield Finding(
            "points",
            "warning",
            text,
            "",
            evidence,
            cause,
            correction(f"intensity_full = {1 / 255:.6f}"),
        )


_TWICE_DIVIDED = 1 / 250


def _surfaces(sweeps: Sequence[Points], config: PointsCheckConfig) -> Iterator[Finding]:
    """Yield a fault where points lie on no surface: bytes that were no coordinates fill a volume."""
    ratios = [
        surface_ratio(sweep.xyz_ego_m, config.surface_points) for sweep in sweeps[:: max(1, len(sweeps) // 2)]
    ]
    known = [ratio for ratio in ratios if not np.isnan(ratio)]
    if known and np.median(known) > config.max_surface_ratio:
        text = f"they lie on no surface: as thick as {np.median(known):.0%} of the distance between them"
        cause = "bytes read as another type, rows of another width, or axes mixed up between points"
        remedy = "state the true type and the number of columns of the files"
        yield Finding("points", "fault", text, "", f"{len(known)} sweeps", cause, remedy)


def surface_ratio(xyz_m: Array, total: int) -> float:
    """Return how thick the surroundings of points are beside their extent, by the median; NaN for few points.

    Args:
        xyz_m: (n, 3) points.
        total: Points that are looked at.
    """
    xyz = np.asarray(xyz_m, dtype=np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if len(xyz) < _MIN_POINTS:
        return float("nan")
    chosen = np.random.default_rng(_SEED).choice(len(xyz), min(total, len(xyz)), replace=False)
    distance, place = cKDTree(xyz).query(xyz[chosen], k=_NEIGHBORS)
    local = xyz[place] - xyz[place].mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", local, local) / _NEIGHBORS)
    thickness = np.sqrt(np.maximum(spread[:, 0], 0))
    return float(np.median(thickness / np.maximum(distance[:, -1], 1e-12)))


def _doubled(sweeps: Sequence[Points], config: PointsCheckConfig) -> Iterator[Finding]:
    """Yield how many points have another one at their place: harmless, but worth a word."""
    shares = [_doubled_share(sweep.xyz_ego_m) for sweep in sweeps[:: max(1, len(sweeps) // 2)]]
    if shares and np.median(shares) > config.max_doubled_share:
        text = f"{np.median(shares):.0%} of a sweep lie where another one lies"
        yield Finding(
            "points", "ok", text, "", f"{len(shares)} sweeps", "two returns of a ray, both kept", ""
        )


def _doubled_share(xyz_m: Array) -> float:
    if not len(xyz_m):
        return 0.0
    bits = np.ascontiguousarray(xyz_m, dtype=np.float32).view(np.int32).astype(np.int64)
    key = (bits[:, 0] * 1_000_003 + bits[:, 1]) * 1_000_003 + bits[:, 2]
    return 1 - len(np.unique(key)) / len(key)


def _places(names: Sequence[int]) -> str:
    named = ", ".join(map(str, names[:_NAMED]))
    return f"frame {named}" + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
