"""Error of a camera's calibration, estimated from sweeps and pictures alone.

Where the sweep jumps from a near surface to one far behind it, the picture mostly has an edge too. The
calibration is right where these outlines lie on edges of the picture (Levinson and Thrun, "Automatic Online
Calibration of Cameras and Lasers", RSS 2013). Beyond the paper: outlines to the left and right are compared with
gradients across the columns of the picture only, and those above with gradients across its rows; the offset is
found by gradient ascent, from blurred edges to sharp ones; its uncertainty comes from how much parts of the
pictures disagree, and from how far the outlines of one side may be displaced together; and where the car moves,
the time of the pictures is estimated with the calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear

from upvl_cli.perception.visual.config import CameraCheckConfig
from upvl_cli.perception.visual.edge_agreement import (
    PARAMETERS,
    UNITS,
    EdgeAgreement,
    downsample,
    downsample_camera,
    edge_strength,
    mean_pool,
)
from upvl_cli.perception.visual.outlines import Outlines, detect_outlines
from upvl_cli.types import Array, Camera, Floats, Ints, concat

_MIN_SIGMA = 0.05  # of UNITS, 0.01 degrees and 1 mm: no drive constrains an offset better
_SHARP_PX = 1.5  # blurred edges of this width lose nothing by pixels of size 1
_SCENE_WIDTH_PX = 80  # width of a picture that shows whether the scene is the same
_STILL_MPS, _STILL_RADPS = 0.5, 0.02  # of a slower car a delay of 50 ms moves nothing by a centimetre


@dataclass(frozen=True)
class ImageSweepPair:
    """A picture and the sweep of that time.

    Attributes:
        rgb: (height, width, 3) uint8.
        xyz_ego_m: (n, 3) points in ego axes at the time of the picture.
        turn_radps: (3,) angular velocity of the car in ego axes.
        velocity_mps: (3,) velocity of the car in ego axes.
    """

    rgb: Array
    xyz_ego_m: Array
    turn_radps: Array = field(default_factory=lambda: np.zeros(3))
    velocity_mps: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def is_moving(self) -> bool:
        """Whether the car moves, so that the time of the picture matters."""
        speed_mps, turn_radps = np.linalg.norm(self.velocity_mps), np.linalg.norm(self.turn_radps)
        return bool(speed_mps > _STILL_MPS or turn_radps > _STILL_RADPS)


@dataclass(frozen=True)
class CalibrationOffset:
    """Error of a calibration: ego_from_camera is the true one times this motion, and pictures are this late.

    Attributes:
        vector: (7,) rotation vector (rad) and translation (m) in the axes of the camera, and delay (s): how much
            later than they say the pictures were taken.
        covariance: (7, 7) of it.
        gain_sigmas: Standard deviations by which the pictures agree better with this offset than with the most likely
            tolerable one.
        fault_gains: (7,) the same against this offset with a typical fault along each axis beside it.
        chance_sigmas: Standard deviations by which the outlines lie better on edges than they would by chance.
        scenes: Number of different scenes that the pictures show.
        outlines: Number of outline points that it rests on.
        has_delay: Whether the delay was estimated: the car moves, and its motion is known.
        config: Tolerances.
    """

    vector: Floats
    covariance: Floats
    gain_sigmas: float
    fault_gains: Floats
    chance_sigmas: float
    scenes: int
    outlines: int
    has_delay: bool
    config: CameraCheckConfig

    @property
    def rotation_rad(self) -> Floats:
        """(3,) rotation vector in the axes of the camera."""
        return self.vector[:3]

    @property
    def translation_m(self) -> Floats:
        """(3,) translation in the axes of the camera."""
        return self.vector[3:6]

    @property
    def delay_s(self) -> float:
        """How much later than they say the pictures were taken."""
        return float(self.vector[6])

    @property
    def sigma(self) -> Floats:
        """(7,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def is_fault(self) -> bool:
        """Whether no calibration and time within the tolerances explain what was seen."""
        return self.is_doubtful and self.gain_sigmas > self.config.gain_sigmas

    @property
    def is_large(self) -> bool:
        """Whether the offset is beyond what the search finds reliably: 1.5 typical rotations, three translations."""
        limits = typical_faults(self.config)[:6] * [1.5, 1.5, 1.5, 3, 3, 3]
        return bool((np.abs(self.vector[:6]) > limits).any())

    @property
    def is_doubtful(self) -> bool:
        """Whether the best offset is beyond the tolerances, however unclear it is that pictures agree better."""
        return self._sigmas_beyond(self.vector, tolerances(self.config)) > self.config.fault_sigmas

    @property
    def explained_by_delay(self) -> bool:
        """Whether a late or early picture explains what was seen, with a calibration within the tolerance."""
        return self.has_delay and self._explained_by(np.arange(PARAMETERS) == 6)

    @property
    def explained_by_mounting(self) -> bool:
        """Whether another mounting explains what was seen, with a delay within the tolerance."""
        return self._explained_by(np.arange(PARAMETERS) < 6)

    def would_detect(self, axis: int) -> bool:
        """Return whether a typical fault along an axis would be reported most likely.

        Args:
            axis: 0 to 2 for a rotation, 3 to 5 for a translation, 6 for a delay.
        """
        if axis == 6 and not self.has_delay:
            return False
        fault = typical_faults(self.config)[axis] * (np.arange(PARAMETERS) == axis)
        sigmas = self._sigmas_beyond(fault, tolerances(self.config))
        spare = self.config.detection_sigmas
        return bool(
            sigmas > self.config.fault_sigmas + spare
            and self.fault_gains[axis] > self.config.gain_sigmas + spare
        )

    def _explained_by(self, free: Array) -> bool:
        bounds = np.where(free, np.inf, tolerances(self.config))
        return self._sigmas_beyond(self.vector, bounds) <= self.config.fault_sigmas

    def _sigmas_beyond(self, vector: Array, bounds: Array) -> float:
        """Return the Mahalanobis distance from an error to the nearest one within bounds."""
        return _nearest(vector / UNITS, self.covariance / np.outer(UNITS, UNITS), bounds / UNITS)[0]


def _nearest(state: Floats, covariance: Floats, limits: Floats) -> tuple[float, Floats]:
    """Return the Mahalanobis distance from an offset to the nearest one within limits, and that one."""
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    nearest = lsq_linear(whiten, whiten @ state, (-limits, limits))
    return float(np.sqrt(2 * nearest.cost)), np.asarray(nearest.x)


def tolerances(config: CameraCheckConfig) -> Floats:
    """Return (7,) largest rotation (rad), translation (m) and delay (s) along each axis that is no fault."""
    rotation_rad = np.deg2rad(config.tolerance_deg)
    return np.array([rotation_rad] * 3 + [config.tolerance_m] * 3 + [config.tolerance_delay_s])


def typical_faults(config: CameraCheckConfig) -> Floats:
    """Return (7,) rotation (rad), translation (m) and delay (s) that the check should find."""
    return np.array([np.deg2rad(config.fault_deg)] * 3 + [config.fault_m] * 3 + [config.fault_delay_s])


def estimate_offset(
    camera: Camera, pairs: Sequence[ImageSweepPair], config: CameraCheckConfig
) -> CalibrationOffset | None:
    """Return the error of a camera's calibration; None where too few outlines are seen.

    Args:
        camera: Its calibration, right within a few degrees and decimeters.
        pairs: What it saw, in order of time; ten or more constrain 1 degree and 5 cm.
        config: Settings of the estimate.
    """
    outlines = concat([_outlines(camera, pair, view, config) for view, pair in enumerate(pairs)], Outlines)
    if len(outlines) < config.min_outlines:
        return None
    outlines = outlines[:: -(-len(outlines) // config.max_outlines)]
    factor = max(1, round(camera.intrinsic[0, 0] / config.max_focal_px))
    strengths = np.stack([edge_strength(downsample(pair.rgb, factor), config.edge_noise) for pair in pairs])
    small = downsample_camera(camera, factor)
    scene = scene_numbers([pair.rgb for pair in pairs], config.scene_change)
    has_delay = any(pair.is_moving for pair in pairs)
    state: Floats = np.zeros(PARAMETERS)
    rounds = [(blur, 3) for blur in config.rotation_blur_deg]
    rounds += [(blur, 6) for blur in config.pose_blur_deg]
    for blur_deg, free in rounds:
        blur_px = max(1.0, np.deg2rad(blur_deg) * small.intrinsic[0, 0])
        pool = max(1, int(blur_px / _SHARP_PX))
        pooled, sharp_px = pool * mean_pool(strengths, pool), blur_px / pool
        agreement = EdgeAgreement(
            downsample_camera(small, pool), outlines, pooled, sharp_px, scene=scene, config=config
        )
        state = agreement.maximize(state, free)
    if has_delay:
        state = _with_delay(agreement, state, config)
    covariance = agreement.covariance(state) + _MIN_SIGMA**2 * np.eye(PARAMETERS)
    limits = tolerances(config) / UNITS
    _, tolerable = _nearest(state, covariance, limits)
    aside = state + np.diag(typical_faults(config) / UNITS)
    return CalibrationOffset(
        vector=state * UNITS,
        covariance=covariance * np.outer(UNITS, UNITS),
        gain_sigmas=agreement.gain_sigmas(state, tolerable),
        fault_gains=np.array([agreement.gain_sigmas(state, other) for other in aside]),
        chance_sigmas=agreement.chance_sigmas(state),
        scenes=int(scene.max()) + 1,
        outlines=len(outlines),
        has_delay=has_delay,
        config=config,
    )


def _with_delay(agreement: EdgeAgreement, state: Floats, config: CameraCheckConfig) -> Floats:
    """Return the offset and the delay of best agreement, from the best of several delays on.

    Args:
        agreement: With sharp edges: blurred ones hardly tell a delay from a turn.
        state: (7,) best offset without a delay, in `UNITS`.
        config: Delays to start from.
    """
    steps = np.arange(-config.max_delay_s, config.max_delay_s, config.delay_step_s) + config.delay_step_s
    delays = np.outer(steps / UNITS[6], np.arange(PARAMETERS) == 6)
    start = min([*delays, *(state + delays)], key=lambda other: agreement.loss(other)[0])
    fits = [agreement.maximize(other, PARAMETERS) for other in (state, start)]
    return min(fits, key=lambda other: agreement.loss(other)[0])


def _outlines(camera: Camera, pair: ImageSweepPair, view: int, config: CameraCheckConfig) -> Outlines:
    """Return the outlines of a sweep with their motion while the car moves."""
    found = detect_outlines(camera, pair.xyz_ego_m, view, config.outline)
    rotation = camera.ego_from_camera[:3, :3]
    xyz_ego_m = found.xyz_m @ rotation.T + camera.ego_from_camera[:3, 3]
    motion_mps = -pair.velocity_mps - np.cross(pair.turn_radps, xyz_ego_m)
    return replace(found, motion_mps=motion_mps @ rotation)


def scene_numbers(pictures: Sequence[Array], change: float) -> Ints:
    """Return (views,) numbers of the scenes of pictures in order of time: a new one where most of it has changed.

    Args:
        pictures: (height, width, 3) uint8 each.
        change: Median change of grey, of 255, from which on a scene is another one.
    """
    scene = np.zeros(len(pictures), dtype=np.int64)
    first: Floats | None = None
    for view, rgb in enumerate(pictures):
        grey = downsample(rgb, max(1, rgb.shape[1] // _SCENE_WIDTH_PX))
        grey = grey - grey.mean()
        changed = first is not None and np.median(np.abs(grey - first)) > change
        scene[view] = (scene[view - 1] if view else 0) + int(changed)
        first = grey if first is None or changed else first
    return scene
