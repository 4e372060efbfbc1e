"""Agreement of the outlines that sweeps show with the edges of pictures, as a smooth function of the calibration."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.lens import distort
from upvl_cli.perception.visual.config import CameraCheckConfig
from upvl_cli.perception.visual.outlines import LEFT, RIGHT, TOP, Outlines
from upvl_cli.types import Array, Bools, Camera, Floats, Ints

# Scale of the parameters in the search: each moves an outline 6 m away by about as much; the delay at 4 m/s.
UNIT_DEG, UNIT_M, UNIT_S = 0.2, 0.02, 0.005
UNITS = np.array([np.deg2rad(UNIT_DEG)] * 3 + [UNIT_M] * 3 + [UNIT_S])
PARAMETERS = len(UNITS)
_MIN_CURVATURE = 1e-4  # of the mean edge strength: where it is flat or turned up, the direction is unobserved
_MIN_SPREAD = 1e-6  # of squared gradients: an unobserved direction is uncertain by ten units
_MIN_DEPTH_M = 0.1
_ASIDE_DEG = (3.0, 5.0)  # far from the edges that belong to the outlines
_CURVATURE_STEP = 0.25  # of UNITS, for finite differences
# Edge strengths: a Sobel-like Gaussian derivative, relative to the mean gradient around it.
_GRADIENT_BLUR_PX, _MIN_WINDOW_PX, _WINDOWS_PER_WIDTH, _MAX_STRENGTH = 1.0, 31, 12, 4.0
_BLUR_GAIN = 2.5  # about sqrt(2 pi): a blurred ridge of one pixel keeps its height


def downsample(rgb: Array, factor: int) -> Floats:
    """Return the grey picture, (height, width), as means over squares of `factor` x `factor` pixels."""
    return mean_pool(rgb.mean(axis=2, dtype=np.float32), factor)


def mean_pool(values: Floats, factor: int) -> Floats:
    """Return (..., height, width) means over squares of `factor` x `factor` pixels; what is left over is cut off."""
    height, width = (length // factor for length in values.shape[-2:])
    cut = values[..., : height * factor, : width * factor]
    cells = cut.reshape(*values.shape[:-2], height, factor, width, factor)
    return np.asarray(cells.mean(axis=(-3, -1)))


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
        self,
        camera: Camera,
        outlines: Outlines,
        strengths: Floats,
        blur_px: float,
        *,
        scene: Ints,
        config: CameraCheckConfig,
    ) -> None:
        """Blur the edges.

        Args:
            camera: Camera of the pictures.
            outlines: Outline points of all sweeps.
            strengths: (views, 2, height, width) from `edge_strength`.
            blur_px: Standard deviation of the blur: how far from an edge an outline is attracted by it.
            scene: (views,) number of the scene that each picture shows: pictures of one scene err together.
            config: Prior, and parts that err independently.
        """
        self.camera, self.outlines, self.config, self.scene = camera, outlines, config, scene
        blur = (0, 0, blur_px, blur_px)
        self.strengths = _BLUR_GAIN * blur_px * ndimage.gaussian_filter(strengths, blur, truncate=3.0)
        sigmas = [np.deg2rad(config.prior_deg)] * 3 + [config.prior_m] * 3 + [config.prior_delay_s]
        self._prior = np.array(sigmas) / UNITS

    def loss(self, state: Floats) -> tuple[float, Floats]:
        """Return minus the mean agreement with a Gaussian prior, and its (7,) gradient.

        Args:
            state: (7,) offset and delay in `UNITS`.
        """
        value, gradient = self.evaluate(state)
        prior = self.config.prior_weight * state / self._prior**2
        return float(-value.mean() + prior @ state / 2), -gradient.mean(axis=0) + prior

    def maximize(self, state: Floats, free: int) -> Floats:
        """Return the offset of best agreement near `state`, where only the first `free` parameters change."""
        bounds = [(None, None)] * free + [(value, value) for value in state[free:]]
        return np.asarray(minimize(self.loss, state, jac=True, method="L-BFGS-B", bounds=bounds).x)

    def evaluate(self, state: Floats, shift_px: Array | float = 0.0) -> tuple[Floats, Floats]:
        """Return (n,) agreement of each outline and its (n, 7) gradient, with pixels shifted by (n, 2)."""
        uv_px, jacobian = self._project(state)
        value, slope = self._interpolate(uv_px + shift_px)
        return value, np.einsum("nk,nkj->nj", slope, jacobian)

    def covariance(self, state: Floats) -> Floats:
        """Return the (7, 7) covariance of the best offset and delay.

        A sandwich estimator (White, "A heteroskedasticity-consistent covariance matrix", Econometrica 1980): the
        inverse curvature around the outer products of gradients, summed over parts that err independently, with the
        usual factor for few parts.
        """
        sums = self._sum_by_part(self.evaluate(state)[1] / len(self.outlines))
        parts = int((sums != 0).any(axis=1).sum())
        few = parts / max(parts - PARAMETERS, 1)
        spread = few * sums.T @ sums + _MIN_SPREAD * np.eye(PARAMETERS)
        for group, shift_px in self._systematic_shifts():
            difference = self.evaluate(state, -shift_px)[1] - self.evaluate(state, shift_px)[1]
            pull = difference[group].sum(axis=0) / (2 * len(self.outlines))
            spread += np.outer(pull, pull)
        values, axes = np.linalg.eigh(self._curvature(state))
        inverse_curvature = axes / np.maximum(values, _MIN_CURVATURE) @ axes.T
        return np.asarray(inverse_curvature @ spread @ inverse_curvature)

    def _curvature(self, state: Floats) -> Floats:
        """Return minus the (7, 7) Hessian of the mean agreement, by central differences of its gradient."""
        step = _CURVATURE_STEP
        rows = [
            (self.evaluate(state - move)[1] - self.evaluate(state + move)[1]).mean(axis=0) / (2 * step)
            for move in step * np.eye(PARAMETERS)
        ]
        return np.asarray(np.array(rows) + np.array(rows).T) / 2

    @cached_property
    def _column_share(self) -> Floats:
        """(n,) column of each outline over the width of the picture, 0 to 1."""
        uv_px, _ = self._project(np.zeros(PARAMETERS))
        return np.asarray(np.clip(uv_px[:, 0] / self.camera.width_px, 0, 1 - 1e-9))

    @cached_property
    def _part(self) -> Ints:
        """(n,) number of the strip of the picture and of the span of time of each outline.

        A span is one scene or more: pictures of the same scene are no independent witnesses.
        """
        scenes = int(self.scene.max()) + 1
        spans = min(self.config.spans, scenes)
        span = self.scene[self.outlines.view] * spans // scenes
        strip = (self._column_share * self.config.strips).astype(np.int64)
        return np.asarray(strip + self.config.strips * span)

    def _sum_by_part(self, values: Floats) -> Floats:
        """Return (parts, k) sums of (n, k) values over strips of the picture and spans of time."""
        sums = np.zeros((self.config.strips * self.config.spans, values.shape[1]))
        np.add.at(sums, self._part, values)
        return sums

    def gain_sigmas(self, better: Floats, worse: Floats) -> float:
        """Return by how many standard deviations one offset agrees better than another, over independent parts.

        Args:
            better: (7,) offset and delay in `UNITS`.
            worse: Another one.
        """
        gain = self.evaluate(better)[0] - self.evaluate(worse)[0]
        sums = self._sum_by_part(np.stack([gain, np.ones(len(gain))], axis=1))
        parts = int((sums[:, 1] > 0).sum())
        if parts < 2 or not gain.any():
            return 0.0
        residual = sums[:, 0] - gain.mean() * sums[:, 1]
        sigma = np.sqrt((residual**2).sum() * parts / (parts - 1)) / len(gain)
        return float(gain.mean() / max(sigma, 1e-12))

    def chance_sigmas(self, state: Floats) -> float:
        """Return by how many standard deviations outlines agree better where they are than moved aside.

        Args:
            state: (7,) offset and delay in `UNITS`.
        """
        focal_px = self.camera.intrinsic[0, 0]
        moves = [
            np.deg2rad(degrees) * focal_px * np.array([np.cos(angle), np.sin(angle)])
            for degrees in _ASIDE_DEG
            for angle in np.pi / 4 * np.arange(8)
        ]
        aside = np.array([self.evaluate(state, move)[0].mean() for move in moves])
        return float((self.evaluate(state)[0].mean() - aside.mean()) / max(aside.std(), 1e-12))

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
        """Return (n, 2) pixels of the outlines and their (n, 2, 7) Jacobian, with the calibration off by `state`."""
        offset = state * UNITS
        rotated = self.outlines.xyz_m @ Rotation.from_rotvec(offset[:3]).as_matrix().T
        xyz_m = rotated + offset[3:6] + offset[6] * self.outlines.motion_mps
        depth_m = np.maximum(xyz_m[:, 2], _MIN_DEPTH_M)
        plane = xyz_m[:, :2] / depth_m[:, None]
        focal_px, center_px = self.camera.intrinsic[:2, :2], self.camera.intrinsic[:2, 2]
        uv_px = distort(self.camera, plane) @ focal_px.T + center_px
        moves = np.zeros((len(xyz_m), 3, PARAMETERS))
        x, y, z = rotated.T
        moves[:, 0, 1], moves[:, 0, 2] = z, -y
        moves[:, 1, 0], moves[:, 1, 2] = -z, x
        moves[:, 2, 0], moves[:, 2, 1] = y, -x
        moves[:, [0, 1, 2], [3, 4, 5]] = 1
        moves[:, :, 6] = self.outlines.motion_mps
        jacobian = (moves[:, :2] - plane[:, :, None] * moves[:, 2:]) / depth_m[:, None, None]
        # Without the distortion of the lens: its effect on the slope is small.
        return uv_px, jacobian * np.diag(focal_px)[:, None] * UNITS

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
