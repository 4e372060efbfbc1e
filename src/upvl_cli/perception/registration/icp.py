"""Rigid registration of two clouds of an upright object: ICP about the vertical, from one or several starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.se3 import apply, compose, from_yaw, rotate, yaw_of
from upvl_cli.perception.registration.config import RegistrationConfig, YawIcpConfig
from upvl_cli.types import Floats

MIN_PAIRS = 3  # fewer pairs of points do not fix a rotation and a translation against noise


class Alignment(NamedTuple):
    """Result of a registration.

    Attributes:
        target_from_source: (4, 4) transform.
        inlier_rmse_m: Root mean square distance of the source points that have a target point within
            the radius; infinite where none has.
        inlier_share: Share of the source points that have one.
    """

    target_from_source: Floats
    inlier_rmse_m: float
    inlier_share: float

    def error_m2(self, radius_m: float) -> float:
        """Return the mean squared distance, where a point without a partner counts as one at the radius."""
        missing = (1 - self.inlier_share) * radius_m**2
        return missing + (self.inlier_share * self.inlier_rmse_m**2 if self.inlier_share else 0.0)


def register_clouds(
    source_xyz_m: Floats,
    target_xyz_m: Floats,
    guesses: Sequence[Floats],
    extent_m: Floats,
    config: RegistrationConfig,
) -> Alignment | None:
    """Register two clouds from several guesses, and from a grid of shifts where these fit badly.

    The alignment of least error is taken (MI-UP, Najibi et al., ECCV 2022, section 4.3: 25 starts on a grid of
    -0.5 to 0.5 lengths and widths; rotation about the vertical only).

    Args:
        source_xyz_m: (n, 3) points to move.
        target_xyz_m: (m, 3) points to reach, in axes along the object.
        guesses: (4, 4) guesses of target_from_source, at least one; the grid is laid about the first.
        extent_m: (2,) length and width of the object, which the grid is scaled by.
        config: ICP, grid, and limits.

    Returns:
        The alignment; None where it leaves too many points without partner or turns too far.
    """
    best, lowest_m2 = None, np.inf
    target = None if not len(target_xyz_m) else cKDTree(target_xyz_m)  # one for all starts
    for number, initial in enumerate(_starts(guesses, extent_m, config.start_offsets)):
        found = _align_to_tree(source_xyz_m, target, initial, config)
        error_m2 = found.error_m2(config.radius_m)
        if error_m2 < lowest_m2:
            best, lowest_m2 = found, error_m2
        all_guessed = number >= len(guesses) - 1
        if all_guessed and best is not None and best.inlier_share >= config.sufficient_inlier_share:
            break
    if best is None or best.inlier_share < config.min_inlier_share:
        return None
    return None if abs(yaw_of(best.target_from_source)) > config.max_yaw_rad else best


def _starts(guesses: Sequence[Floats], extent_m: Floats, offsets: tuple[float, ...]) -> Iterator[Floats]:
    """Yield the guesses, then the first one shifted along x and y by shares of the extent."""
    yield from guesses
    for along in offsets:
        for across in offsets:
            if along or across:
                shift = from_yaw(0.0, np.array([along, across, 0.0]) * [*extent_m, 0.0])
                yield compose(shift, guesses[0])


def align_yaw(source_xyz_m: Floats, target_xyz_m: Floats, initial: Floats, config: YawIcpConfig) -> Alignment:
    """Align two clouds by point-to-point ICP with rotation about the vertical only.

    Besl and McKay, A Method for Registration of 3-D Shapes, PAMI 1992; the closed form of a step is Umeyama's
    (PAMI 1991) with the rotation confined to one axis.

    Args:
        source_xyz_m: (n, 3) points to move.
        target_xyz_m: (m, 3) points to reach.
        initial: (4, 4) first guess of target_from_source.
        config: Correspondence radius and when to stop.

    Returns:
        The alignment; the guess itself where fewer than three pairs were ever within the radius.
    """
    tree = None if not len(target_xyz_m) else cKDTree(target_xyz_m)
    return _align_to_tree(source_xyz_m, tree, initial, config)


def _align_to_tree(
    source_xyz_m: Floats, tree: cKDTree | None, initial: Floats, config: YawIcpConfig
) -> Alignment:
    """Align a cloud to the points of a tree, None for no point; see `align_yaw`."""
    target_from_source = np.array(initial, dtype=np.float64)
    if not len(source_xyz_m) or tree is None:
        return Alignment(target_from_source, float("inf"), 0.0)
    source = np.asarray(source_xyz_m, dtype=np.float64)
    moved = apply(target_from_source, source)
    for _ in range(config.max_iterations):
        distance, nearest = tree.query(moved, distance_upper_bound=config.radius_m)
        paired = np.isfinite(distance)
        if paired.sum() < MIN_PAIRS:
            break
        step = fit_yaw(moved[paired], tree.data[nearest[paired]])
        target_from_source = compose(step, target_from_source)
        before, moved = moved, apply(target_from_source, source)
        if np.abs(moved - before).max() < config.tolerance_m:
            break
    return _evaluate(tree, target_from_source, moved, config.radius_m)


def fit_yaw(source_xyz_m: Floats, target_xyz_m: Floats) -> Floats:
    """Fit rotation about the vertical and translation to pairs of points, least squares.

    Args:
        source_xyz_m: (n, 3) points, n >= 1.
        target_xyz_m: (n, 3) where each of them should lie.

    Returns:
        (4, 4) target_from_source.
    """
    center, goal = source_xyz_m.mean(axis=0), target_xyz_m.mean(axis=0)
    x, y = (source_xyz_m - center)[:, :2].T
    u, v = (target_xyz_m - goal)[:, :2].T
    yaw = np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum())
    fit = np.eye(4)
    fit[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    fit[:3, 3] = goal - rotate(fit, center[None])[0]
    return fit


def _evaluate(tree: cKDTree, target_from_source: Floats, moved: Floats, radius_m: float) -> Alignment:
    distance, _ = tree.query(moved, distance_upper_bound=radius_m)
    inliers = distance[np.isfinite(distance)]
    rmse_m = float(np.sqrt(np.mean(inliers**2))) if len(inliers) else float("inf")
    return Alignment(target_from_source, rmse_m, len(inliers) / len(moved))
