"""The motion of the car between two sweeps, from the sweeps alone: no pose, no unit, no axes are believed.

A search over all displacements that a car can make in that time gives the first guess (correlation of occupied cells
by FFT, for each yaw), and ICP in the plane of the road refines it: each voxel is drawn to the surface or pole near
its partner, weighted by how that surface spreads (Segal et al., Generalized-ICP, RSS 2009, in the plane). How much the
sectors around the car disagree gives the uncertainty (jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft

from upvl_cli.geometry.se3 import apply, from_yaw
from upvl_cli.perception.drive_check.motion_config import RegisterConfig
from upvl_cli.perception.drive_check.upright_structure import UprightStructure
from upvl_cli.types import Array, Floats, Ints


@dataclass(frozen=True)
class PlanarMotion:
    """Motion in the plane of the road: target_from_source as x, y and yaw.

    Attributes:
        vector: (3,) x (m), y (m), yaw (rad).
        covariance: (3, 3) of the vector.
        inlier_share: Share of the voxels of the source with a partner.
    """

    vector: Floats
    covariance: Floats
    inlier_share: float

    @property
    def matrix(self) -> Floats:
        """(4, 4) target_from_source."""
        return from_yaw(float(self.vector[2]), np.array([self.vector[0], self.vector[1], 0.0]))


def measure_motion(
    source: UprightStructure,
    target: UprightStructure,
    dt_s: float,
    config: RegisterConfig,
    guesses: Sequence[Floats] = (),
) -> PlanarMotion | None:
    """Return the motion target_from_source in the plane of the road; None where the sweeps do not show it.

    Args:
        source: The later sweep.
        target: The earlier sweep.
        dt_s: Time between them.
        config: Limits and noise.
        guesses: (3,) motions to start from too, such as what other pairs show.
    """
    if min(len(source), len(target)) < config.neighbors:
        return None
    surfaces = surface_information(target, config)
    coarse = coarse_motions(source, target, dt_s, config)
    candidates = [
        guess + (x, y, 0.0)
        for guess in (*coarse, *guesses)
        for x in config.start_offsets_m
        for y in config.start_offsets_m
    ]
    few = source.thinned(config.start_points)
    scores = [agreement(few, target, surfaces, start, config) for start in candidates]
    best, highest = None, 0.0
    for place in np.argsort(-np.array(scores), kind="stable")[: config.starts]:
        found = refine_motion(source, target, surfaces, candidates[place], config)
        score = agreement(source, target, surfaces, found.vector, config) if found else 0.0
        if score > highest:
            best, highest = found, score
    return best


def agreement(
    source: UprightStructure,
    target: UprightStructure,
    surfaces: Floats,
    vector: Floats,
    config: RegisterConfig,
) -> float:
    """Return how well a motion explains two sweeps: 1 where every voxel lies on a surface of the other, 0 for none."""
    found = match_surfaces(source, target, surfaces, vector, config.radius_m[-1])
    return float((1 / (1 + found.mahalanobis / 4)).sum()) / max(len(source), 1)


def coarse_motions(
    source: UprightStructure, target: UprightStructure, dt_s: float, config: RegisterConfig
) -> list[Floats]:
    """Return first guesses (x, y, yaw) by the overlap of occupied cells, best first."""
    cell_m = config.coarse_cell_m
    reach = int(np.ceil(config.max_speed_mps * dt_s / cell_m)) + 2
    turn = config.max_turn_rate_radps * dt_s
    steps = int(np.ceil(turn / config.coarse_yaw_rad))
    extent_m = max(np.abs(part.xyz_m[:, :2]).max() for part in (source, target))
    size = int(fft.next_fast_len(2 * int(np.ceil(extent_m / cell_m)) + reach + 4, real=True))
    fixed = np.conj(fft.rfft2(_occupied(target.xyz_m[:, :2], size, cell_m)))
    scores, places = [], []
    for yaw in config.coarse_yaw_rad * np.arange(-steps, steps + 1):
        turned = apply(from_yaw(float(yaw), np.zeros(3)), source.xyz_m)[:, :2]
        overlap = fft.irfft2(np.conj(fft.rfft2(_occupied(turned, size, cell_m)) * fixed), s=(size, size))
        window = np.roll(overlap, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
        at = int(np.argmax(window))
        scores.append(float(window.ravel()[at]))
        row, column = divmod(at, 2 * reach + 1)
        places.append(np.array([(row - reach) * cell_m, (column - reach) * cell_m, yaw]))
    order = np.argsort(-np.array(scores), kind="stable")
    return [places[order[0]]]


def _occupied(xy_m: Floats, size: int, cell_m: float) -> Floats:
    """Return (size, size) float32: 1 in cells that hold a voxel, less in their neighbors."""
    grid = np.zeros((size, size), np.float32)
    cell = np.floor(xy_m / cell_m).astype(np.int64) % size
    grid[cell[:, 0], cell[:, 1]] = 1.0
    return grid


def surface_information(target: UprightStructure, config: RegisterConfig) -> Floats:
    """Return (n, 3) inverse covariance of each voxel's surface in the plane: xx, xy, yy in 1/m2."""
    places = target.tree.data
    _, near = target.tree.query(places, k=min(config.neighbors, len(places)))
    xy = target.xyz_m[:, :2][near]
    xy = xy - xy.mean(axis=1, keepdims=True)
    noise = config.noise_m**2
    xx, yy = (xy[..., 0] ** 2).mean(axis=1) + noise, (xy[..., 1] ** 2).mean(axis=1) + noise
    cross = (xy[..., 0] * xy[..., 1]).mean(axis=1)
    determinant = xx * yy - cross**2
    return np.asarray(np.stack([yy, -cross, xx], axis=1) / determinant[:, None])


def refine_motion(
    source: UprightStructure,
    target: UprightStructure,
    surfaces: Floats,
    guess: Floats,
    config: RegisterConfig,
) -> PlanarMotion | None:
    """Refine a guess by ICP in the plane; None where the sweeps do not fix the motion."""
    vector = np.array(guess, dtype=np.float64)
    for radius_m in config.radius_m:
        for _ in range(config.iterations):
            system = _Normal.build(source, target, surfaces, vector, radius_m, config)
            if system is None:
                return None
            step = system.solve()
            vector = vector + step
            if np.abs(step * (1, 1, 20)).max() < 2e-3:
                break
    system = _Normal.build(source, target, surfaces, vector, config.radius_m[-1], config)
    if system is None or system.inlier_share < config.min_inlier_share:
        return None
    covariance = system.covariance()
    if not np.sqrt(np.trace(covariance[:2, :2])) < config.max_sigma_m:
        return None
    return PlanarMotion(vector, covariance, system.inlier_share)


class SurfaceMatch(NamedTuple):
    """Voxels of a source with a partner in the target.

    Attributes:
        row: (k,) their rows in the source.
        partner: (k,) rows of the partners in the target.
        moved_m: (k, 3) where they come to lie.
        gap_m: (k, 2) from there to the partners, in the plane.
        surface: (k, 3) inverse covariance of the partners' surfaces.
        mahalanobis: (k,) squared distance in standard deviations of the surfaces.
    """

    row: Ints
    partner: Ints
    moved_m: Floats
    gap_m: Floats
    surface: Floats
    mahalanobis: Floats

    @property
    def weight(self) -> Floats:
        """(k,) weight of each, by the robust kernel of Geman and McClure at two standard deviations."""
        return np.asarray(1 / (1 + self.mahalanobis / 4) ** 2)


def match_surfaces(
    source: UprightStructure, target: UprightStructure, surfaces: Floats, vector: Floats, radius_m: float
) -> SurfaceMatch:
    """Return the voxels of a source that have a partner within a radius once a motion is applied."""
    moved = apply(from_yaw(float(vector[2]), np.array([vector[0], vector[1], 0.0])), source.xyz_m)
    distance, partner = target.tree.query(target.search_places(moved), distance_upper_bound=radius_m)
    row = np.flatnonzero(np.isfinite(distance))
    partner, moved = partner[row], moved[row]
    gap = target.xyz_m[partner, :2] - moved[:, :2]
    surface = surfaces[partner]
    mahalanobis = (
        surface[:, 0] * gap[:, 0] ** 2
        + 2 * surface[:, 1] * gap[:, 0] * gap[:, 1]
        + surface[:, 2] * gap[:, 1] ** 2
    )
    return SurfaceMatch(row, partner, moved, gap, surface, mahalanobis)


@dataclass(frozen=True)
class _Normal:
    """Normal equations of one step, a block for each sector.

    Attributes:
        hessian: (sectors, 3, 3).
        gradient: (sectors, 3).
        inlier_share: Share of voxels with a partner.
    """

    hessian: Floats
    gradient: Floats
    inlier_share: float

    @staticmethod
    def build(
        source: UprightStructure,
        target: UprightStructure,
        surfaces: Floats,
        vector: Floats,
        radius_m: float,
        config: RegisterConfig,
    ) -> _Normal | None:
        found = match_surfaces(source, target, surfaces, vector, radius_m)
        if len(found.gap_m) < config.neighbors:
            return None
        moved, gap = found.moved_m, found.gap_m
        xx, xy, yy = found.surface.T
        weight = found.weight
        lever = moved - (vector[0], vector[1], 0.0)
        jacobian = np.zeros((len(moved), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -lever[:, 1], lever[:, 0]
        weighted = np.empty_like(jacobian)
        weighted[:, 0] = weight[:, None] * (xx[:, None] * jacobian[:, 0] + xy[:, None] * jacobian[:, 1])
        weighted[:, 1] = weight[:, None] * (xy[:, None] * jacobian[:, 0] + yy[:, None] * jacobian[:, 1])
        sector = ((np.arctan2(lever[:, 1], lever[:, 0]) / (2 * np.pi) + 0.5) * config.sectors).astype(
            np.int64
        )
        sector = np.minimum(sector, config.sectors - 1)
        total = config.sectors
        hessian, gradient = np.zeros((total, 3, 3)), np.zeros((total, 3))
        for row in range(3):
            values = weighted[:, 0, row] * gap[:, 0] + weighted[:, 1, row] * gap[:, 1]
            gradient[:, row] = np.bincount(sector, weights=values, minlength=total)
            for column in range(row, 3):
                values = (
                    weighted[:, 0, row] * jacobian[:, 0, column]
                    + weighted[:, 1, row] * jacobian[:, 1, column]
                )
                hessian[:, row, column] = np.bincount(sector, weights=values, minlength=total)
                hessian[:, column, row] = hessian[:, row, column]
        return _Normal(hessian, gradient, len(gap) / len(source))

    def solve(self) -> Floats:
        """Return the (3,) step."""
        return np.asarray(np.linalg.solve(self.hessian.sum(axis=0), self.gradient.sum(axis=0)))

    def covariance(self) -> Array:
        """Return the (3, 3) covariance by leaving out one sector after the other."""
        total_h, total_g = self.hessian.sum(axis=0), self.gradient.sum(axis=0)
        without = np.linalg.solve(total_h - self.hessian, (total_g - self.gradient)[..., None])[..., 0]
        spread = without - without.mean(axis=0)
        count = len(spread)
        return np.asarray((count - 1) / count * np.einsum("ki,kj->ij", spread, spread))
