"""Checks of cameras: their pictures, which way they look, their calibration and their time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import apply, compose, inverse
from upvl_cli.perception.drive_check.calibration_words import calibration_finding
from upvl_cli.perception.drive_check.camera_config import CamerasConfig
from upvl_cli.perception.drive_check.camera_hypotheses import (
    axes_setting,
    camera_hypotheses,
    turns_of_points,
    yaw_hypotheses,
)
from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.drive_check.pictures import check_copies, check_pictures
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.visual.camera_axes import EdgeMaps, SweepOutlines, sweep_outlines
from upvl_cli.perception.visual.camera_check import ImageSweepPair, estimate_offset
from upvl_cli.perception.visual.edge_agreement import downsample, downsample_camera, edge_strength
from upvl_cli.types import Array, Camera, Floats, Image, concat

_SKEW = 1e-3  # of a rotation matrix times its transpose: more is no rounding
_MOTION_S = 0.05  # the motion of the car is taken from this long before to this long after a picture

Pictures = Mapping[int, Image]  # by step


@dataclass(frozen=True)
class _View:
    """A camera whose pictures show something.

    Attributes:
        camera: As given.
        pictures: By step.
        edges: Edges of some of them.
        given_sigmas: How well the outlines agree with them as the camera is given; NaN where few are in view.
        factor: How much smaller those pictures are.
    """

    camera: Camera
    pictures: Pictures
    edges: EdgeMaps
    given_sigmas: float
    factor: int

    def sigmas(self, camera: Camera, outlines: SweepOutlines, config: CamerasConfig) -> float:
        """Return how well outlines agree with the edges if the camera were another one; -inf where few are seen."""
        small = downsample_camera(camera, self.factor)
        found = self.edges.agreement_sigmas(small, outlines, config.axes)
        return found if np.isfinite(found) else -np.inf


def check_cameras(sample: DriveSample, config: CamerasConfig) -> Iterator[Finding]:
    """Yield the findings on the cameras of a drive, coarse before fine.

    Where the axes are wrong, no offset is estimated.

    Args:
        sample: The drive; without poses it is not known how the car moved between a picture and its sweep.
        config: Settings.
    """
    steps = camera_steps(sample, config)
    shown: dict[str, Mapping[int, Image | None]] = {}
    usable: list[Camera] = []
    for camera in sample.cameras:
        findings = list(_mounting(camera))
        pictures = {step: sample.picture(step, camera.name) for step in steps}
        findings += check_pictures(sample, camera, pictures, config.picture)
        yield from findings
        shown[camera.name] = pictures
        if not any(finding.is_fault for finding in findings):
            usable.append(camera)
    copies = list(check_copies(shown, config.picture))
    yield from copies
    if copies:
        return
    outlines = concat(
        [sweep_outlines(_main_sweep(sample, step), sample.ground_z_m, step, config.axes) for step in steps],
        SweepOutlines,
    )
    views = [_view(sample, camera, steps, outlines, config) for camera in usable]
    axes = list(_turned_points(views, outlines, config))
    yield from axes
    if axes:
        return
    for view in views:
        wrong = list(_wrong_mounting(view, views, outlines, config))
        yield from wrong or [_calibration(sample, view, config)]


def camera_steps(sample: DriveSample, config: CamerasConfig) -> tuple[int, ...]:
    """Return the steps whose pictures are checked, evenly spread; fewer where there are many cameras."""
    per_camera = config.images // max(1, len(sample.cameras))
    count = int(np.clip(per_camera, config.min_frames, config.max_frames))
    steps = np.array(sample.steps, dtype=int)
    places = np.unique(np.linspace(0, len(steps) - 1, min(count, len(steps))).round().astype(int))
    return tuple(steps[places].tolist())


def image_sweep_pairs(sample: DriveSample, pictures: Pictures) -> Iterator[ImageSweepPair]:
    """Yield each picture with the sweep of its step in the ego axes of the time of the picture.

    Args:
        sample: The drive; without poses a sweep stays in the ego axes of its step.
        pictures: Pictures of one camera, by step.
    """
    poses = sample.world_from_ego
    times_ns = [frame.time_ns for frame in sample.frames]
    for step, image in pictures.items():
        xyz_m = _main_sweep(sample, step)
        if poses is None or len(poses) < 2:
            yield ImageSweepPair(image.rgb, xyz_m)
            continue
        world_from_image = pose_at(times_ns, poses, image.time_ns)
        if image.time_ns != sample.frames[step].time_ns:
            xyz_m = apply(compose(inverse(world_from_image), poses[step]), xyz_m)
        before, after = (
            pose_at(times_ns, poses, image.time_ns + round(sign * _MOTION_S * 1e9)) for sign in (-1, 1)
        )
        motion = compose(inverse(before), after)
        turn_radps = Rotation.from_matrix(motion[:3, :3]).as_rotvec() / (2 * _MOTION_S)
        yield ImageSweepPair(image.rgb, xyz_m, turn_radps, motion[:3, 3] / (2 * _MOTION_S))


def _main_sweep(sample: DriveSample, step: int) -> Array:
    """Return (n, 3) points of the LiDAR of most points: others are mounted elsewhere and see behind things."""
    points = sample.sweep(step)
    main = np.bincount(points.sensor, minlength=1).argmax()
    return np.asarray(points.xyz_ego_m[points.sensor == main])


def _mounting(camera: Camera) -> Iterator[Finding]:
    """Yield a finding where the matrices of a camera cannot be right."""
    turn = camera.ego_from_camera[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > _SKEW or np.linalg.det(turn) < 0:
        yield Finding(
            f"camera {camera.name}",
            "fault",
            "the rotation of its ego_from_camera is none",
            cause="an axis is mirrored, or a number is wrong",
            remedy="look at the calibration",
        )
    center = camera.intrinsic[:2, 2] / [camera.width_px, camera.height_px]
    if (center < 0).any() or (center > 1).any():
        yield Finding(
            f"camera {camera.name}",
            "fault",
            f"the middle of its view lies at ({camera.intrinsic[0, 2]:.0f}, {camera.intrinsic[1, 2]:.0f}) px, "
            f"outside of its pictures of {camera.width_px} x {camera.height_px} px",
            cause="the intrinsics belong to pictures of another size",
            remedy="multiply fx, fy, cx and cy by the ratio of the sizes",
        )


def _view(
    sample: DriveSample,
    camera: Camera,
    steps: Sequence[int],
    outlines: SweepOutlines,
    config: CamerasConfig,
) -> _View:
    """Return a camera with the edges of its pictures."""
    found = {step: sample.picture(step, camera.name) for step in steps}
    pictures = {step: image for step, image in found.items() if image is not None}
    places = np.linspace(0, len(pictures) - 1, min(config.axes.pictures, len(pictures))).round().astype(int)
    chosen = np.array(list(pictures))[np.unique(places)]
    focal_px = float(camera.intrinsic[0, 0])
    factor = max(1, round(focal_px / config.axes.focal_px))
    noise = config.calibration.edge_noise
    strengths = [edge_strength(downsample(pictures[step].rgb, factor), noise) for step in chosen.tolist()]
    blur_px = max(1.0, np.deg2rad(config.axes.blur_deg) * focal_px / factor)
    edges = EdgeMaps(np.stack(strengths), blur_px, chosen)
    given = edges.agreement_sigmas(downsample_camera(camera, factor), outlines, config.axes)
    return _View(camera, pictures, edges, given, factor)


def _turned_points(
    views: Sequence[_View], outlines: SweepOutlines, config: CamerasConfig
) -> Iterator[Finding]:
    """Yield a finding where one turn of the points explains all cameras, and the points as given do not."""
    if not views:
        return
    count = np.sqrt(len(views))
    given = sum(np.nan_to_num(view.given_sigmas) for view in views) / count
    best, name = -np.inf, ""
    turn: Floats = np.eye(3)
    for rotation, words in turns_of_points():
        moved = outlines.transform(rotation)
        sigmas = sum(max(view.sigmas(view.camera, moved, config), 0.0) for view in views) / count
        if sigmas > best:
            best, name, turn = sigmas, words, rotation
    if best < config.clear_sigmas or best < given + config.better_sigmas:
        return
    among = f"all {len(views)} cameras" if len(views) > 1 else f"camera {views[0].camera.name}"
    cause = f"the points are {name}; expected x forward, y left, z up"
    yield Finding(
        "axes",
        "fault",
        f"the points fit the pictures of {among} only when they are turned",
        evidence=f"agreement of {best:.1f} standard deviations instead of {given:.1f}",
        cause=cause if len(views) > 1 else f"{cause}; or the mounting of the camera is wrong by as much",
        remedy=correction(axes_setting(turn)),
    )


def _wrong_mounting(
    view: _View, views: Sequence[_View], outlines: SweepOutlines, config: CamerasConfig
) -> Iterator[Finding]:
    """Yield a finding where a typical mistake explains a camera, and the calibration as given does not."""
    given = view.given_sigmas if np.isfinite(view.given_sigmas) else 0.0
    cameras = [other.camera for other in views]
    for hypotheses, clear in (
        (camera_hypotheses(view.camera, cameras), config.clear_sigmas),
        (yaw_hypotheses(view.camera), config.clear_sigmas + config.better_sigmas),  # many: one fits by chance
    ):
        if given > config.clear_sigmas - config.better_sigmas:
            return
        found = [(view.sigmas(each.camera, outlines, config), each) for each in hypotheses]
        best, explanation = max(found, key=lambda pair: pair[0])
        if best > clear and best > given + config.better_sigmas:
            yield Finding(
                f"camera {view.camera.name}",
                "fault",
                f"the points do not fit its pictures as it is given; {explanation.text}",
                evidence=f"agreement of {best:.1f} standard deviations instead of {given:.1f}",
                cause=explanation.cause,
                remedy=explanation.remedy,
            )
            return


def _calibration(sample: DriveSample, view: _View, config: CamerasConfig) -> Finding:
    """Return the finding on the calibration and the time of a camera."""
    pairs = list(image_sweep_pairs(sample, view.pictures))
    found = estimate_offset(view.camera, pairs, config.calibration)
    # A large offset is the nearest chance agreement of a camera that looks elsewhere, unless it looks roughly right.
    if found is not None and found.is_large and not view.given_sigmas > config.clear_sigmas:
        found = None
    return calibration_finding(view.camera.name, len(pairs), found, config.min_scenes)
