"""By how much the calibration of a camera is off, seen from sweeps and pictures alone.

Where the sweep jumps from a near surface to one far behind it, the picture mostly has an edge too. The
calibration is right where these outlines lie on edges of the picture (Levinson and Thrun, "Automatic Online
Calibration of Cameras and Lasers", RSS 2013). Beyond the paper: outlines to the left and right are held
against changes across the picture only and those above against changes along its columns; the offset is found
by its gradient from blurred edges to sharp ones; and its uncertainty comes from how much parts of the pictures
disagree, and from how far an outline may lie off as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.optimize import lsq_linear, minimize
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.camera import distort
from upvl_cli.perception.visual.outlines import LEFT, RIGHT, TOP, Outlines, joined, outlines
from upvl_cli.types import Array, Bools, Camera, Floats

UNITS = np.array([np.deg2rad(0.2)] * 3 + [0.02] * 3)  # both move an outline 6 m away by about as much
GOOD_ENOUGH = np.array([np.deg2rad(0.1)] * 3 + [0.01] * 3)  # offsets up to here are no fault
# Of 17 right cameras (bench/check.py) the worst came to 2.1.
_SIGMAS = 2.6
_FOCAL_PX = 800.0  # sharper pictures are made smaller: a LiDAR's samples lie farther apart than their pixels
# Blur of the edges in degrees, and how many of the six are free: first the rotation, which may be off by degrees.
_BLURS = ((1.28, 3), (0.64, 3), (0.32, 6), (0.16, 6))
_PRIOR = np.array([10.0] * 3 + [5.0] * 3)  # 2 degrees, 10 cm: keeps what no outline tells near 0
_PRIOR_WEIGHT = 1e-2
_LEAST_OUTLINES = 300
_FINEST = 0.05  # of UNITS: no drive tells more
_STRIPS, _SPANS = 8, 3  # parts of the pictures, and of the time, that are taken to err independently
# How far all outlines of one side may lie off together: half a step between a LiDAR's columns, or its rows.
_SIDE_OFF_RAD = np.deg2rad([0.05, 0.05, 0.1])
_SIDE_OFF_PX = 0.5  # nor does a picture of few pixels tell more


@dataclass(frozen=True)
class View:
    """A picture and the sweep around it.

    Attributes:
        rgb: (height, width, 3) uint8.
        xyz_ego_m: (n, 3) points in the ego axes of the time when the picture was taken.
    """

    rgb: Array
    xyz_ego_m: Array


@dataclass(frozen=True)
class Offset:
    """How a calibration differs from the truth: ego_from_camera is the true one times this motion.

    Attributes:
        six: (6,) rotation vector (rad) and translation (m) in the axes of the camera.
        covariance: (6, 6) of it.
        outlines: How many points on outlines it rests on.
    """

    six: Floats
    covariance: Floats
    outlines: int

    @property
    def sigma(self) -> Floats:
        """(6,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_off(self) -> bool:
        """Whether no calibration that is good enough explains what was seen."""
        return self._sigmas_off(self.six) > _SIGMAS

    def tells(self, six: Array) -> bool:
        """Whether a calibration that is off by (6,) would most likely be reported: with one sigma to spare."""
        return self._sigmas_off(six) > _SIGMAS + 1

    def _sigmas_off(self, six: Array) -> float:
        """Distance from an offset to the nearest one that is good enough, in standard deviations."""
        whiten = np.linalg.inv(np.linalg.cholesky(self.covariance))
        nearest = lsq_linear(whiten, whiten @ six, (-GOOD_ENOUGH, GOOD_ENOUGH))
        return float(np.sqrt(2 * nearest.cost))


def offset(camera: Camera, views: Sequence[View]) -> Offset | None:
    """Return how far the calibration of a camera is off; None where too few outlines are seen.

    Args:
        camera: Its calibration, right within a few degrees and decimetres.
        views: What it saw, in order of time; ten or more tell 1 degree and 5 cm.
    """
    if not views:
        return None
    every = joined([outlines(camera, view.xyz_ego_m, number) for number, view in enumerate(views)])
    if len(every) < _LEAST_OUTLINES:
        return None
    shrink = max(1, round(camera.intrinsic[0, 0] / _FOCAL_PX))
    maps = np.stack([edges(smaller(view.rgb, shrink)) for view in views])
    seen_by = smaller_camera(camera, shrink)
    state: Floats = np.zeros(6)
    for blur_rad, free in _BLURS:
        agreement = Agreement(seen_by, every, maps, max(1.0, np.deg2rad(blur_rad) * seen_by.intrinsic[0, 0]))
        state = agreement.best(state, free)
    covariance = agreement.covariance(state) + _FINEST**2 * np.eye(6)
    return Offset(state * UNITS, covariance * np.outer(UNITS, UNITS), len(every))


def smaller(rgb: Array, shrink: int) -> Floats:
    """Return the grey picture, (height, width), with `shrink` times fewer pixels along each side."""
    grey = rgb.astype(np.float32).mean(axis=2)
    height, width = (length // shrink for length in grey.shape)
    cells = grey[: height * shrink, : width * shrink].reshape(height, shrink, width, shrink)
    return np.asarray(cells.mean(axis=(1, 3)))


def smaller_camera(camera: Camera, shrink: int) -> Camera:
    """Return the camera of the smaller picture."""
    intrinsic = camera.intrinsic.copy()
    intrinsic[:2, 2] -= (shrink - 1) / 2  # (0, 0) is the centre of the first pixel
    intrinsic[:2] /= shrink
    width_px, height_px = camera.width_px // shrink, camera.height_px // shrink
    return replace(camera, intrinsic=intrinsic, width_px=width_px, height_px=height_px)


def edges(grey: Floats) -> Floats:
    """Return (2, height, width) how much of an edge each pixel is: across the columns, and across the rows.

    Only ridges count, beside the usual change around them: a wall of leaves is no better than a roof.
    """
    around_px = max(31, grey.shape[1] // 12)
    found = []
    for axis, order in ((1, (0, 1)), (0, (1, 0))):
        change = np.abs(ndimage.gaussian_filter(grey, 1.0, order=order))
        ridge = change >= ndimage.maximum_filter1d(change, 3, axis=axis)
        usual = ndimage.uniform_filter(change, around_px) + 1.5  # noise of a picture: 1 or 2 of 255
        found.append(np.minimum(np.where(ridge, change / usual, 0), 4.0))
    return np.stack(found).astype(np.float32)


class Agreement:
    """How well outlines lie on the edges of pictures, as a smooth function of the offset."""

    def __init__(self, camera: Camera, points: Outlines, maps: Floats, blur_px: float) -> None:
        """Blur the edges.

        Args:
            camera: Of the pictures.
            points: The outlines.
            maps: (views, 2, height, width) from `edges`.
            blur_px: How far from an edge an outline still feels it.
        """
        self.camera, self.points = camera, points
        blur = (0, 0, blur_px, blur_px)
        self.maps = 2.5 * blur_px * ndimage.gaussian_filter(maps, blur, truncate=3.0)

    def loss(self, state: Floats) -> tuple[float, Floats]:
        """Minus the mean agreement, and its slope; `state` is the offset in `UNITS`."""
        value, slope = self.each(state)
        held = _PRIOR_WEIGHT * state / _PRIOR**2
        return float(-value.mean() + held @ state / 2), -slope.mean(axis=0) + held

    def best(self, state: Floats, free: int) -> Floats:
        """The offset that agrees best near another one, where the first so many of the six may change."""
        bounds = [(None, None)] * free + [(value, value) for value in state[free:]]
        return np.asarray(minimize(self.loss, state, jac=True, method="L-BFGS-B", bounds=bounds).x)

    def each(self, state: Floats, moved_px: Array | float = 0.0) -> tuple[Floats, Floats]:
        """(n,) agreement of each outline and (n, 6) its slope, where pixels are moved by (n, 2)."""
        uv_px, slope = self._placed(state)
        value, change = self._edge(uv_px + moved_px)
        return value, np.einsum("nk,nkj->nj", change, slope)

    def covariance(self, state: Floats) -> Floats:
        """(6, 6) covariance of the best offset: the "sandwich" of curvature and slopes that disagree."""
        slopes = self.each(state)[1] / len(self.points)
        middle = self._sum_by_part(slopes)
        spread = middle.T @ middle
        for group, moved_px in self._common_moves():
            before = self.each(state, -moved_px)[1] - self.each(state, moved_px)[1]
            pulled = before[group].sum(axis=0) / (2 * len(self.points))
            spread += np.outer(pulled, pulled)
        values, axes = np.linalg.eigh(self._curvature(state))
        back = axes / np.maximum(values, 1e-4) @ axes.T  # flat or turned up: nothing is known along it
        return np.asarray(back @ spread @ back)

    def _curvature(self, state: Floats, step: float = 0.25) -> Floats:
        """(6, 6) how fast the mean slope falls around an offset."""
        rows = [
            (self.each(state - move)[1] - self.each(state + move)[1]).mean(axis=0) / (2 * step)
            for move in step * np.eye(6)
        ]
        return np.asarray(np.array(rows) + np.array(rows).T) / 2

    @cached_property
    def _column(self) -> Floats:
        """(n,) where each outline lies across the picture, 0 to 1."""
        uv_px, _ = self._placed(np.zeros(6))
        return np.asarray(np.clip(uv_px[:, 0] / self.camera.width_px, 0, 1 - 1e-9))

    def _sum_by_part(self, slopes: Floats) -> Floats:
        """(parts, 6) sums over strips of the picture and spans of time."""
        span = self.points.view * _SPANS // (self.points.view.max() + 1)
        part = (self._column * _STRIPS).astype(int) + _STRIPS * span
        sums = np.zeros((_STRIPS * _SPANS, 6))
        np.add.at(sums, part, slopes)
        return sums

    def _common_moves(self) -> list[tuple[Bools, Floats]]:
        """Outlines that may lie off together, by side, range and half of the picture, and by how many pixels."""
        depth_m = self.points.xyz_m[:, 2]
        near = depth_m < np.median(depth_m)
        left = self._column < 0.5
        moves: list[tuple[Bools, Floats]] = []
        for side in (LEFT, RIGHT, TOP):
            moved_px = np.zeros(2)
            off_px = _SIDE_OFF_RAD[side] * self.camera.intrinsic[0, 0]
            moved_px[int(side == TOP)] = max(off_px, _SIDE_OFF_PX)
            for close in (near, ~near):
                for half in (left, ~left):
                    moves.append((np.asarray((self.points.side == side) & close & half), moved_px))
        return moves

    def _placed(self, state: Floats) -> tuple[Floats, Floats]:
        """(n, 2) pixels of the outlines and (n, 2, 6) their slopes, where the calibration is off by `state`."""
        offset = state * UNITS
        turned = self.points.xyz_m @ Rotation.from_rotvec(offset[:3]).as_matrix().T
        xyz_m = turned + offset[3:]
        depth_m = np.maximum(xyz_m[:, 2], 0.1)
        plane = xyz_m[:, :2] / depth_m[:, None]
        focal_px, centre_px = self.camera.intrinsic[:2, :2], self.camera.intrinsic[:2, 2]
        uv_px = distort(self.camera, plane) @ focal_px.T + centre_px
        moves = np.zeros((len(xyz_m), 3, 6))
        x, y, z = turned.T
        moves[:, 0, 1], moves[:, 0, 2] = z, -y
        moves[:, 1, 0], moves[:, 1, 2] = -z, x
        moves[:, 2, 0], moves[:, 2, 1] = y, -x
        moves[:, [0, 1, 2], [3, 4, 5]] = 1
        slope = (moves[:, :2] - plane[:, :, None] * moves[:, 2:]) / depth_m[:, None, None]
        return uv_px, slope * np.diag(focal_px)[:, None] * UNITS  # the lens bends less than this needs

    def _edge(self, uv_px: Floats) -> tuple[Floats, Floats]:
        """(n,) edges at pixels, between the four around each, and (n, 2) their slopes; 0 outside."""
        height, width = self.maps.shape[-2:]
        u, v = np.clip(uv_px, 0, [width - 1.001, height - 1.001]).T
        inside = np.asarray(((uv_px >= 0) & (uv_px <= [width - 1, height - 1])).all(axis=1))
        column, row = u.astype(int), v.astype(int)
        right, down = u - column, v - row
        across = np.where(self.points.side == TOP, 1, 0)
        flat, first = self.maps.reshape(-1), ((self.points.view * 2 + across) * height + row) * width + column
        a, b, c, d = (flat.take(first + step) for step in (0, 1, width, width + 1))
        value = (a * (1 - right) + b * right) * (1 - down) + (c * (1 - right) + d * right) * down
        slope_u = (b - a) * (1 - down) + (d - c) * down
        slope_v = (c - a) * (1 - right) + (d - b) * right
        return value * inside, np.stack([slope_u, slope_v], axis=1) * inside[:, None]
