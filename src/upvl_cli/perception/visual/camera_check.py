"""Error of a camera's calibration, estimated from sweeps and pictures alone.

Where the sweep jumps from a near surface to one far behind it, the picture mostly has an edge too. The
calibration is right where these outlines lie on edges of the picture (Levinson and Thrun, "Automatic Online
Calibration of Cameras and Lasers", RSS 2013). Beyond the paper: outlines to the left and right are compared with
gradients across the columns of the picture only, and those above with gradients across its rows; the offset is
found by gradient ascent, from blurred edges to sharp ones; and its uncertainty comes from how much parts of the
pictures disagree, and from how far the outlines of one side may be displaced together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.optimize import lsq_linear, minimize
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.lens import distort
from upvl_cli.perception.visual.config import CameraCheckConfig
from upvl_cli.perception.visual.outlines import LEFT, RIGHT, TOP, Outlines, detect_outlines
from upvl_cli.types import Array, Bools, Camera, Floats, concat

# Scale of the six parameters in the search: either moves an outline 6 m away by about as much.
_UNIT_DEG, _UNIT_M = 0.2, 0.02
_UNITS = np.array([np.deg2rad(_UNIT_DEG)] * 3 + [_UNIT_M] * 3)
_MIN_SIGMA = 0.05  # of _UNITS, 0.01 degrees and 1 mm: no drive constrains an offset better
_MIN_CURVATURE = 1e-4  # of the mean edge strength: where it is flat or turned up, the direction is unobserved
_MIN_DEPTH_M = 0.1
_CURVATURE_STEP = 0.25  # of _UNITS, for finite differences
# Edge strengths: a Sobel-like Gaussian derivative, relative to the mean gradient around it.
_GRADIENT_BLUR_PX, _MIN_WINDOW_PX, _WINDOWS_PER_WIDTH, _MAX_STRENGTH = 1.0, 31, 12, 4.0
_BLUR_GAIN = 2.5  # about sqrt(2 pi): a blurred ridge of one pixel keeps its height


@dataclass(frozen=True)
class ImageSweepPair:
    """A picture and the sweep of that time.

    Attributes:
        rgb: (height, width, 3) uint8.
        xyz_ego_m: (n, 3) points in ego axes at the time of the picture.
    """

    rgb: Array
    xyz_ego_m: Array


@dataclass(frozen=True)
class CalibrationOffset:
    """Error of a calibration: ego_from_camera is the true one times this motion.

    Attributes:
        vector: (6,) rotation vector (rad) and translation (m) in the axes of the camera.
        covariance: (6, 6) of it.
        outlines: Number of outline points that it rests on.
        config: Tolerances.
    """

    vector: Floats
    covariance: Floats
    outlines: int
    config: CameraCheckConfig

    @property
    def rotation_rad(self) -> Floats:
        """(3,) rotation vector in the axes of the camera."""
        return self.vector[:3]

    @property
    def translation_m(self) -> Floats:
        """(3,) translation in the axes of the camera."""
        return self.vector[3:]

    @property
    def sigma(self) -> Floats:
        """(6,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_fault(self) -> bool:
        """Whether no calibration within the tolerance explains what was seen."""
        return self._sigmas_beyond_tolerance(self.vector) > self.config.fault_sigmas

    def would_detect(self, vector: Array) -> bool:
        """Return whether a calibration with the (6,) error `vector` would be reported most likely."""
        sigmas = self._sigmas_beyond_tolerance(vector)
        return sigmas > self.config.fault_sigmas + self.config.detection_sigmas

    def _sigmas_beyond_tolerance(self, vector: Array) -> float:
        """Return the Mahalanobis distance from an error to the nearest tolerable one."""
        tolerance = tolerances(self.config)
        whiten = np.linalg.inv(np.linalg.cholesky(self.covariance))
        nearest = lsq_linear(whiten, whiten @ vector, (-tolerance, tolerance))
        return float(np.sqrt(2 * nearest.cost))


def tolerances(config: CameraCheckConfig) -> Floats:
    """Return (6,) largest rotation (rad) and translation (m) along each axis that is no fault."""
    return np.array([np.deg2rad(config.tolerance_deg)] * 3 + [config.tolerance_m] * 3)


def estimate_offset(
    camera: Camera, pairs: Sequence[ImageSweepPair], config: CameraCheckConfig
) -> CalibrationOffset | None:
    """Return the error of a camera's calibration; None where too few outlines are seen.

    Args:
        camera: Its calibration, right within a few degrees and decimeters.
        pairs: What it saw, in order of time; ten or more constrain 1 degree and 5 cm.
        config: Settings of the estimate.
    """
    if not pairs:
        return None
    parts = [
        detect_outlines(camera, pair.xyz_ego_m, number, config.outline) for number, pair in enumerate(pairs)
    ]
    outlines = concat(parts, Outlines)
    if len(outlines) < config.min_outlines:
        return None
    factor = max(1, round(camera.intrinsic[0, 0] / config.max_focal_px))
    strengths = np.stack([edge_strength(downsample(pair.rgb, factor), config.edge_noise) for pair in pairs])
    small = downsample_camera(camera, factor)
    state: Floats = np.zeros(6)
    rounds = [
        *((blur, 3) for blur in config.rotation_blur_deg),
        *((blur, 6) for blur in config.pose_blur_deg),
    ]
    for blur_deg, free in rounds:
        blur_px = max(1.0, np.deg2rad(blur_deg) * small.intrinsic[0, 0])
        agreement = EdgeAgreement(small, outlines, strengths, blur_px, config)
        state = agreement.maximize(state, free)
    covariance = agreement.covariance(state) + _MIN_SIGMA**2 * np.eye(6)
    return CalibrationOffset(state * _UNITS, covariance * np.outer(_UNITS, _UNITS), len(outlines), config)


def downsample(rgb: Array, factor: int) -> Floats:
    """Return the grey picture, (height, width), as means over squares of `factor` x `factor` pixels."""
    grey = rgb.astype(np.float32).mean(axis=2)
    height, width = (length // factor for length in grey.shape)
    cells = grey[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(cells.mean(axis=(1, 3)))


def downsample_camera(camera: Camera, factor: int) -> Camera:
    """Return the camera of the picture that `downsample` gives."""
    intrinsic = camera.intrinsic.copy()
    intrinsic[:2, 2] -= (factor - 1) / 2  # (0, 0) is the center of the first pixel
    intrinsic[:2] /= factor
    width_px, height_px = camera.width_px // factor, camera.height_px // factor
    return replace(camera, intrinsic=intrinsic, width_px=width_px, height_px=height_px)


def edge_strength(grey: Floats, noise: float) -> Floats:
    """Return (2, height, width) edge strength of each pixel: across the columns, and across the rows.

    Only ridges of the gradient count, relative to the mean gradient around them: a wall of leaves is no stronger
    than the edge of a roof.

    Args:
        grey: (height, width) picture, 0 to 255.
        noise: Gradient of a plain surface by noise.
    """
    around_px = max(_MIN_WINDOW_PX, grey.shape[1] // _WINDOWS_PER_WIDTH)
    strengths = []
    for axis, order in ((1, (0, 1)), (0, (1, 0))):
        gradient = np.abs(ndimage.gaussian_filter(grey, _GRADIENT_BLUR_PX, order=order))
        ridge = gradient >= ndimage.maximum_filter1d(gradient, 3, axis=axis)
        mean = ndimage.uniform_filter(gradient, around_px) + noise
        strengths.append(np.minimum(np.where(ridge, gradient / mean, 0), _MAX_STRENGTH))
    return np.stack(strengths).astype(np.float32)


class EdgeAgreement:
    """Mean edge strength of the pictures at outlines of the sweeps, as a smooth function of the offset."""

    def __init__(
        self, camera: Camera, outlines: Outlines, strengths: Floats, blur_px: float, config: CameraCheckConfig
    ) -> None:
        """Blur the edges.

        Args:
            camera: Camera of the pictures.
            outlines: Outline points of all sweeps.
            strengths: (views, 2, height, width) from `edge_strength`.
            blur_px: Standard deviation of the blur: how far from an edge an outline is attracted by it.
            config: Prior, and parts that err independently.
        """
        self.camera, self.outlines, self.config = camera, outlines, config
        blur = (0, 0, blur_px, blur_px)
        self.strengths = _BLUR_GAIN * blur_px * ndimage.gaussian_filter(strengths, blur, truncate=3.0)
        self._prior = np.array([config.prior_deg / _UNIT_DEG] * 3 + [config.prior_m / _UNIT_M] * 3)

    def loss(self, state: Floats) -> tuple[float, Floats]:
        """Return minus the mean agreement with a Gaussian prior, and its (6,) gradient.

        Args:
            state: (6,) offset in `_UNITS`.
        """
        value, gradient = self.evaluate(state)
        prior = self.config.prior_weight * state / self._prior**2
        return float(-value.mean() + prior @ state / 2), -gradient.mean(axis=0) + prior

    def maximize(self, state: Floats, free: int) -> Floats:
        """Return the offset of best agreement near `state`, where only the first `free` parameters change."""
        bounds = [(None, None)] * free + [(value, value) for value in state[free:]]
        return np.asarray(minimize(self.loss, state, jac=True, method="L-BFGS-B", bounds=bounds).x)

    def evaluate(self, state: Floats, shift_px: Array | float = 0.0) -> tuple[Floats, Floats]:
        """Return (n,) agreement of each outline and its (n, 6) gradient, with pixels shifted by (n, 2)."""
        uv_px, jacobian = self._project(state)
        value, slope = self._interpolate(uv_px + shift_px)
        return value, np.einsum("nk,nkj->nj", slope, jacobian)

    def covariance(self, state: Floats) -> Floats:
        """Return the (6, 6) covariance of the best offset.

        A sandwich estimator (White, "A heteroskedasticity-consistent covariance matrix", Econometrica 1980): the
        inverse curvature around the outer products of gradients, summed over parts that err independently.
        """
        gradients = self.evaluate(state)[1] / len(self.outlines)
        sums = self._sum_by_part(gradients)
        spread = sums.T @ sums
        for group, shift_px in self._systematic_shifts():
            difference = self.evaluate(state, -shift_px)[1] - self.evaluate(state, shift_px)[1]
            pull = difference[group].sum(axis=0) / (2 * len(self.outlines))
            spread += np.outer(pull, pull)
        values, axes = np.linalg.eigh(self._curvature(state))
        inverse_curvature = axes / np.maximum(values, _MIN_CURVATURE) @ axes.T
        return np.asarray(inverse_curvature @ spread @ inverse_curvature)

    def _curvature(self, state: Floats) -> Floats:
        """Return minus the (6, 6) Hessian of the mean agreement, by central differences of its gradient."""
        step = _CURVATURE_STEP
        rows = [
            (self.evaluate(state - move)[1] - self.evaluate(state + move)[1]).mean(axis=0) / (2 * step)
            for move in step * np.eye(6)
        ]
        return np.asarray(np.array(rows) + np.array(rows).T) / 2

    @cached_property
    def _column_share(self) -> Floats:
        """(n,) column of each outline over the width of the picture, 0 to 1."""
        uv_px, _ = self._project(np.zeros(6))
        return np.asarray(np.clip(uv_px[:, 0] / self.camera.width_px, 0, 1 - 1e-9))

    def _sum_by_part(self, gradients: Floats) -> Floats:
        """Return (parts, 6) sums over strips of the picture and spans of time."""
        strips, spans = self.config.strips, self.config.spans
        span = self.outlines.view * spans // (self.outlines.view.max() + 1)
        part = (self._column_share * strips).astype(int) + strips * span
        sums = np.zeros((strips * spans, 6))
        np.add.at(sums, part, gradients)
        return sums

    def _systematic_shifts(self) -> list[tuple[Bools, Floats]]:
        """Return groups of outlines by side, depth and half of the picture, and their common shift in pixels.

        The sampling of the LiDAR displaces all outlines of one side alike.
        """
        depth_m = self.outlines.xyz_m[:, 2]
        near = depth_m < np.median(depth_m)
        left = self._column_share < 0.5
        shifts: list[tuple[Bools, Floats]] = []
        for side in (LEFT, RIGHT, TOP):
            offset_deg = self.config.row_offset_deg if side == TOP else self.config.column_offset_deg
            offset_px = np.deg2rad(offset_deg) * self.camera.intrinsic[0, 0]
            shift_px = np.zeros(2)
            shift_px[int(side == TOP)] = max(offset_px, self.config.min_offset_px)
            for depth in (near, ~near):
                for half in (left, ~left):
                    group = np.asarray((self.outlines.side == side) & depth & half)
                    shifts.append((group, shift_px))
        return shifts

    def _project(self, state: Floats) -> tuple[Floats, Floats]:
        """Return (n, 2) pixels of the outlines and their (n, 2, 6) Jacobian, with the calibration off by `state`."""
        offset = state * _UNITS
        rotated = self.outlines.xyz_m @ Rotation.from_rotvec(offset[:3]).as_matrix().T
        xyz_m = rotated + offset[3:]
        depth_m = np.maximum(xyz_m[:, 2], _MIN_DEPTH_M)
        plane = xyz_m[:, :2] / depth_m[:, None]
        focal_px, center_px = self.camera.intrinsic[:2, :2], self.camera.intrinsic[:2, 2]
        uv_px = distort(self.camera, plane) @ focal_px.T + center_px
        moves = np.zeros((len(xyz_m), 3, 6))
        x, y, z = rotated.T
        moves[:, 0, 1], moves[:, 0, 2] = z, -y
        moves[:, 1, 0], moves[:, 1, 2] = -z, x
        moves[:, 2, 0], moves[:, 2, 1] = y, -x
        moves[:, [0, 1, 2], [3, 4, 5]] = 1
        jacobian = (moves[:, :2] - plane[:, :, None] * moves[:, 2:]) / depth_m[:, None, None]
        # Without the distortion of the lens: its effect on the slope is small.
        return uv_px, jacobian * np.diag(focal_px)[:, None] * _UNITS

    def _interpolate(self, uv_px: Floats) -> tuple[Floats, Floats]:
        """Return (n,) bilinear edge strengths at pixels and their (n, 2) gradients; 0 outside of the picture."""
        height, width = self.strengths.shape[-2:]
        u, v = np.clip(uv_px, 0, [width - 1.001, height - 1.001]).T
        inside = np.asarray(((uv_px >= 0) & (uv_px <= [width - 1, height - 1])).all(axis=1))
        column, row = u.astype(int), v.astype(int)
        right, down = u - column, v - row
        across = np.where(self.outlines.side == TOP, 1, 0)
        flat, first = (
            self.strengths.reshape(-1),
            ((self.outlines.view * 2 + across) * height + row) * width + column,
        )
        a, b, c, d = (flat.take(first + step) for step in (0, 1, width, width + 1))
        value = (a * (1 - right) + b * right) * (1 - down) + (c * (1 - right) + d * right) * down
        slope_u = (b - a) * (1 - down) + (d - c) * down
        slope_v = (c - a) * (1 - right) + (d - b) * right
        return value * inside, np.stack([slope_u, slope_v], axis=1) * inside[:, None]
