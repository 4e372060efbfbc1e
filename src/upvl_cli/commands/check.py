"""What is wrong with a drive before it is labelled: its times, its pictures, its calibration; without any label."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.visual.camera_check import (
    CalibrationOffset,
    ImageSweepPair,
    estimate_offset,
    tolerances,
)
from upvl_cli.pipeline.tables import Table
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Array, Camera, Frame, Image

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Drive

_SKEW = 1e-3  # of a rotation matrix times its transpose: more is no rounding
_CLEAR_SIGMAS = 2.0  # an axis of a faulty calibration is named from here on
_AXES = (
    "its x axis (to the right)",
    "its y axis (downwards)",
    "its z axis (the view)",
)


@dataclass(frozen=True)
class Finding:
    """One result of the check.

    Attributes:
        about: Name of the camera, or "drive".
        text: One line for people.
        faulty: Whether it should be repaired before the drive is labelled.
        offset: Estimated error of the calibration; None where that was not estimated.
    """

    about: str
    text: str
    faulty: bool = False
    offset: CalibrationOffset | None = None

    def __str__(self) -> str:
        return f"{self.about}: {self.text}"


def check(workspace: Workspace, segment: str) -> Iterator[Finding]:
    """Yield the findings on a drive: first on its frames, then on each camera.

    Args:
        workspace: Names the dataset, and holds check.toml; a drive without poses uses those of `odometry`, where
            they were made.
        segment: Name of the drive.

    Raises:
        BadInput: The drive cannot be read.
    """
    drive = workspace.drive(segment)
    poses = drive.world_from_ego
    path = workspace.shard("odometry", segment)
    if poses is None and path.is_file():
        table = Table(path, OdometryRow)
        if table.frames == tuple(frame.index for frame in drive.frames):
            poses = np.array([row.world_from_ego for row in table])
    yield from check_drive(drive, poses, load(CheckConfig, workspace.stages / "check.toml"))


def check_drive(drive: Drive, poses: Array | None, config: CheckConfig) -> Iterator[Finding]:
    """Yield the findings on a drive; cameras are checked only where times ascend.

    Args:
        drive: The drive.
        poses: (T, 4, 4) poses of its frames, if there are any.
        config: Settings of the check.
    """
    on_frames = list(_frames(drive))
    yield from on_frames
    if any(finding.faulty for finding in on_frames):
        return
    if not drive.cameras:
        yield Finding("drive", "has no camera")
    for camera in drive.cameras:
        yield from _camera(drive, camera, poses, config)


def _frames(drive: Drive) -> Iterator[Finding]:
    """Yield what was left out of a drive, and times that go back."""
    for reason, count in drive.skipped.items():
        yield Finding("drive", f"{count} left out: {reason}")
    steps_ns = np.diff([frame.time_ns for frame in drive.frames])
    back = np.flatnonzero(steps_ns <= 0)
    if len(back):
        after = drive.frames[back[0] + 1].index
        text = (
            f"frame {after} is not later than the one before it ({len(back)} such): look at the time stamps"
        )
        yield Finding("drive", text, faulty=True)


def _camera(drive: Drive, camera: Camera, poses: Array | None, config: CheckConfig) -> Iterator[Finding]:
    """Yield the findings on one camera: its mounting, its pictures and their times, its calibration."""
    turn = camera.ego_from_camera[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > _SKEW or np.linalg.det(turn) < 0:
        text = "the rotation of its ego_from_camera is none: look at the calibration"
        yield Finding(camera.name, text, faulty=True)
        return
    frames = sample_frames(drive, config)
    pictures = dict(zip(frames, in_order(lambda f: drive.image(f.index, camera.name), frames), strict=True))
    seen = {frame: image for frame, image in pictures.items() if image is not None}
    if len(seen) < len(frames):
        text = f"no picture in {len(frames) - len(seen)} of {len(frames)} frames looked at"
        yield Finding(camera.name, text, faulty=not seen)
    wrong = [
        image.rgb.shape
        for image in seen.values()
        if image.rgb.shape[:2] != (camera.height_px, camera.width_px)
    ]
    if wrong:
        text = (
            f"a picture has {wrong[0][1]} x {wrong[0][0]} pixels, expected {camera.width_px} x "
            f"{camera.height_px}: use pictures and calibration of one size"
        )
        yield Finding(camera.name, text, faulty=True)
        return
    delay_s = max((abs(image.time_ns - frame.time_ns) / 1e9 for frame, image in seen.items()), default=0.0)
    if delay_s > config.max_delay_s:
        allowed = f"expected {config.max_delay_s} at most"
        text = f"a picture is {delay_s:.2f} s from its sweep, {allowed}: look at the time stamps"
        yield Finding(camera.name, text, faulty=True)
    yield _calibration(camera, list(image_sweep_pairs(drive, seen, poses)), config)


def sample_frames(drive: Drive, config: CheckConfig) -> tuple[Frame, ...]:
    """Return the frames to check, evenly spread over the drive; fewer where there are many cameras."""
    per_camera = config.images // max(1, len(drive.cameras))
    count = int(np.clip(per_camera, config.min_frames, config.max_frames))
    total = len(drive.frames)
    steps = np.unique(np.linspace(0, total - 1, min(count, total)).round().astype(int))
    return tuple(drive.frames[step] for step in steps)


def image_sweep_pairs(
    drive: Drive, images: Mapping[Frame, Image], poses: Array | None
) -> Iterator[ImageSweepPair]:
    """Yield each picture with the sweep of its frame in the ego axes of the time of the picture.

    Args:
        drive: The drive.
        images: Pictures of one camera, by frame.
        poses: (T, 4, 4) poses of all frames; without them the sweep stays in the ego axes of its frame.
    """
    for frame, image in images.items():
        points = drive.points(frame.index)
        # Only the LiDAR of most points: others are mounted elsewhere and see behind what this one sees.
        xyz_m = points.xyz_ego_m[points.sensor == np.bincount(points.sensor, minlength=1).argmax()]
        if poses is not None and image.time_ns != frame.time_ns and len(poses) > 1:
            world_from_image, world_from_frame = (
                pose_at([each.time_ns for each in drive.frames], poses, time_ns)
                for time_ns in (image.time_ns, frame.time_ns)
            )
            xyz_m = apply(inverse(world_from_image) @ world_from_frame, xyz_m)
        yield ImageSweepPair(image.rgb, xyz_m)


def _calibration(camera: Camera, pairs: Sequence[ImageSweepPair], config: CheckConfig) -> Finding:
    """Return the finding on the calibration of a camera."""
    found = estimate_offset(camera, pairs, config.camera)
    if found is None:
        return Finding(camera.name, f"too few outlines in {len(pairs)} pictures to check the calibration")
    if found.is_fault:
        errors = " and ".join(_errors(found))
        return Finding(camera.name, f"{errors}: look at the calibration", faulty=True, offset=found)
    faults = np.diag([np.deg2rad(config.fault_deg)] * 3 + [config.fault_m] * 3)
    missed = [_fault_in_words(axis, config) for axis in range(6) if not found.would_detect(faults[axis])]
    text = "no fault seen in the calibration" + (f"; it would miss {', '.join(missed)}" if missed else "")
    return Finding(camera.name, text, offset=found)


def _errors(found: CalibrationOffset) -> Iterator[str]:
    """Yield the axes along or about which a calibration is off, in words; at least the clearest one."""
    sigmas = np.abs(found.vector) / found.sigma
    off = (np.abs(found.vector) > tolerances(found.config)) & (sigmas > _CLEAR_SIGMAS)
    off[np.argmax(sigmas)] = True
    for axis in np.flatnonzero(off):
        if axis < 3:
            size, sigma = np.rad2deg([found.vector[axis], found.sigma[axis]])
            yield f"rotated by {size:.2f} +- {sigma:.2f} degrees about {_AXES[axis]}"
        else:
            size, sigma = found.vector[axis] * 100, found.sigma[axis] * 100
            yield f"moved by {size:.1f} +- {sigma:.1f} cm along {_AXES[axis - 3]}"


def _fault_in_words(axis: int, config: CheckConfig) -> str:
    if axis < 3:
        return f"{config.fault_deg:g} degree{'' if config.fault_deg == 1 else 's'} about {'xyz'[axis]}"
    return f"{100 * config.fault_m:g} cm along {'xyz'[axis - 3]}"
