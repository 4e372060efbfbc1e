"""Which way a camera looks, roughly: the outlines of a sweep all round against the edges of pictures.

A coarse relative of `camera_check`: it can say that a camera looks somewhere else entirely, or that the axes of the
points are turned against those of the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from upvl_cli.geometry.camera import project
from upvl_cli.perception.visual.config import CameraAxesConfig
from upvl_cli.types import Array, Camera, Floats, Ints, ParallelArrays, array, concat

_SENSOR_HEIGHT_M = 1.8  # of a LiDAR above the road, roughly: only neighbourhoods in the sweep depend on it
_MIN_RANGE_M, _MAX_RANGE_M = 2.0, 60.0
_TANGENT_SHARE = 0.02  # of its range: how far along its tangent an outline is followed to see how it runs
_ASIDE_DEG = (4.0, 7.0, 11.0)  # far from the edges that belong to the outlines
_DIRECTIONS = 8
_GAIN = 2.5  # about sqrt(2 pi): a blurred ridge of one pixel keeps its height


@dataclass(frozen=True)
class SweepOutlines(ParallelArrays):
    """Places where a near surface ends before a far one, all round the car.

    Attributes:
        xyz_ego_m: (n, 3) in ego axes.
        tangent: (n, 3) unit vector along the outline.
        view: (n,) number of the sweep.
    """

    xyz_ego_m: Array = array("float64", 3)
    tangent: Array = array("float64", 3)
    view: Array = array("int64")

    def transform(self, rotation: Array) -> SweepOutlines:
        """Return the outlines turned or mirrored about the origin by a (3, 3) matrix."""
        return SweepOutlines(self.xyz_ego_m @ rotation.T, self.tangent @ rotation.T, self.view)


def sweep_outlines(xyz_ego_m: Array, ground_z_m: float, view: int, config: CameraAxesConfig) -> SweepOutlines:
    """Return the outlines of a sweep, from its range image.

    Args:
        xyz_ego_m: (n, 3) points.
        ground_z_m: Height of the road.
        view: Number of the sweep, for the result.
        config: Size of the cells of the range image.
    """
    xyz = np.asarray(xyz_ego_m, dtype=np.float64) - [0, 0, ground_z_m + _SENSOR_HEIGHT_M]
    level_m = np.hypot(xyz[:, 0], xyz[:, 1])
    inside = np.flatnonzero((level_m > _MIN_RANGE_M) & (level_m < _MAX_RANGE_M))
    xyz, level_m = xyz[inside], level_m[inside]
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    elevation = np.arctan2(xyz[:, 2], level_m)
    cell_rad = np.deg2rad([config.column_deg, config.row_deg])
    columns, rows = int(2 * np.pi / cell_rad[0]), int(np.pi / cell_rad[1])
    column = ((azimuth + np.pi) / (2 * np.pi) * columns).astype(int) % columns
    row = ((elevation + np.pi / 2) / cell_rad[1]).astype(int)
    order = np.argsort(-level_m, kind="stable")  # the nearest point of a cell is written last
    range_m, index = np.full((columns, rows), np.nan), np.zeros((columns, rows), dtype=np.int64)
    range_m[column[order], row[order]] = level_m[order]
    index[column[order], row[order]] = inside[order]
    parts = []
    for axis, step in ((0, 1), (0, -1), (1, 1)):
        here = index[_ends(range_m, axis, step, config)]
        point = np.asarray(xyz_ego_m[here], dtype=np.float64)
        tangent = np.tile([0.0, 0.0, 1.0], (len(point), 1))
        if axis == 1:
            tangent = np.stack([-point[:, 1], point[:, 0], np.zeros(len(point))], axis=1)
            tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        parts.append(SweepOutlines(point, tangent, np.full(len(point), view)))
    return concat(parts, SweepOutlines)


def _ends(range_m: Floats, axis: int, step: int, config: CameraAxesConfig) -> Array:
    """Return where the surface in a cell ends towards the next cell along an axis."""
    beyond = np.roll(range_m, -step, axis)
    beyond = np.where(np.isnan(beyond), np.roll(range_m, -2 * step, axis), beyond)
    inner = np.roll(range_m, step, axis)
    with np.errstate(invalid="ignore"):
        far = beyond - range_m > np.maximum(config.min_range_gap_m, config.min_range_gap_share * range_m)
        return np.asarray(far & (np.abs(inner - range_m) < config.same_surface_m))


class EdgeMaps:
    """Blurred edges of pictures of one camera, for any hypothesis about its calibration."""

    def __init__(self, strengths: Floats, blur_px: float, views: Ints) -> None:
        """Blur the edges.

        Args:
            strengths: (pictures, 2, height, width) from `edge_strength`.
            blur_px: Standard deviation of the blur.
            views: (pictures,) number of the sweep that belongs to each.
        """
        blur = (0, 0, blur_px, blur_px)
        self.strengths = _GAIN * blur_px * ndimage.gaussian_filter(strengths, blur, truncate=3.0)
        self.views = views

    def agreement_sigmas(self, camera: Camera, outlines: SweepOutlines, config: CameraAxesConfig) -> float:
        """Return by how many standard deviations outlines lie on edges better than they would moved aside.

        Args:
            camera: The hypothesis, with the size of the pictures; NaN where too few outlines are in view.
            outlines: All round the car.
            config: Fewest and most outlines.
        """
        uv_px, _, visible = project(camera, outlines.xyz_ego_m)
        visible &= np.isin(outlines.view, self.views)
        shown = np.flatnonzero(visible)
        shown = shown[:: -(-len(shown) // config.max_outlines) or 1]
        if len(shown) < config.min_outlines:
            return float("nan")
        xyz, tangent = outlines.xyz_ego_m[shown], outlines.tangent[shown]
        along_m = _TANGENT_SHARE * np.linalg.norm(xyz, axis=1, keepdims=True)
        run_px = np.abs(project(camera, xyz + along_m * tangent)[0] - uv_px[shown])
        channel = np.where(run_px[:, 0] > run_px[:, 1], 1, 0)
        view = np.searchsorted(self.views, outlines.view[shown])
        focal_px = float(np.sqrt(np.abs(np.linalg.det(camera.intrinsic[:2, :2]))))
        angle = 2 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        moves = np.concatenate([np.deg2rad(degrees) * focal_px * around for degrees in _ASIDE_DEG])
        mean = np.array([self._mean(uv_px[shown] + move, channel, view) for move in moves])
        here = max(
            self._mean(uv_px[shown] + move, channel, view)
            for move in (np.zeros(2), *(np.deg2rad(config.search_deg) * focal_px * around))
        )
        return float((here - mean.mean()) / max(mean.std(), 1e-9))

    def _mean(self, uv_px: Array, channel: Ints, view: Ints) -> float:
        """Return the mean edge strength at (n, 2) pixels; those that left the picture do not count."""
        height, width = self.strengths.shape[-2:]
        column, row = np.rint(uv_px).astype(np.int64).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        if not inside.any():
            return 0.0
        return float(self.strengths[view[inside], channel[inside], row[inside], column[inside]].mean())
