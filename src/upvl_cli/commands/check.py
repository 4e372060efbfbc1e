"""What is wrong with a drive before it is labelled: its times, its pictures, its calibration; without any label."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.visual.camera_check import GOOD_ENOUGH, Offset, View, offset
from upvl_cli.pipeline.tables import Table
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Array, Camera, Frame, Image

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Drive

_PICTURES = 60  # looked at in one drive, over all its cameras
_FEWEST_FRAMES, _MOST_FRAMES = 8, 20
_LATE_S = 0.1  # a picture farther from its sweep shows another scene
_SKEW = 1e-3  # a rotation that is farther from one is no rounding
_AXES = (
    "its x axis (to the right)",
    "its y axis (downwards)",
    "its z axis (the view)",
)
_FAULTS = np.array([np.deg2rad(1.0)] * 3 + [0.05] * 3)  # what a check should see


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        about: Name of the camera, or "drive".
        text: One line for people.
        faulty: Whether it should be mended before the drive is labelled.
        offset: How far the calibration seems to be off; None where that was not estimated.
    """

    about: str
    text: str
    faulty: bool = False
    offset: Offset | None = None

    def __str__(self) -> str:
        return f"{self.about}: {self.text}"


def check(workspace: Workspace, segment: str) -> Iterator[Finding]:
    """Yield what is found on a drive: first on its frames, then on each camera.

    Args:
        workspace: Where the drive is; a drive without poses uses those of `odometry` where they were made.
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
    yield from check_drive(drive, poses)


def check_drive(drive: Drive, poses: Array | None) -> Iterator[Finding]:
    """Yield what is found on a drive with its poses, (T, 4, 4); no camera is looked at where times go back."""
    of_frames = list(_frames(drive))
    yield from of_frames
    if any(finding.faulty for finding in of_frames):
        return
    if not drive.cameras:
        yield Finding("drive", "has no camera")
    for camera in drive.cameras:
        yield from _camera(drive, camera, poses)


def _frames(drive: Drive) -> Iterator[Finding]:
    """What was left out of a drive, and times that go back."""
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


def _camera(drive: Drive, camera: Camera, poses: Array | None) -> Iterator[Finding]:
    """What is found on one camera: its mounting, its pictures and their times, its calibration."""
    turn = camera.ego_from_camera[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > _SKEW or np.linalg.det(turn) < 0:
        text = "the rotation of its ego_from_camera is none: look at the calibration"
        yield Finding(camera.name, text, faulty=True)
        return
    frames = chosen(drive)
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
    late_s = max((abs(image.time_ns - frame.time_ns) / 1e9 for frame, image in seen.items()), default=0.0)
    if late_s > _LATE_S:
        text = (
            f"a picture is {late_s:.2f} s from its sweep, expected {_LATE_S} at most: look at the time stamps"
        )
        yield Finding(camera.name, text, faulty=True)
    yield _calibration(camera, list(views(drive, seen, poses)))


def chosen(drive: Drive) -> tuple[Frame, ...]:
    """Return the frames to look at, evenly from the drive; fewer where there are many cameras."""
    most = int(np.clip(_PICTURES // max(1, len(drive.cameras)), _FEWEST_FRAMES, _MOST_FRAMES))
    total = len(drive.frames)
    places = np.unique(np.linspace(0, total - 1, min(most, total)).round().astype(int))
    return tuple(drive.frames[place] for place in places)


def views(drive: Drive, seen: Mapping[Frame, Image], poses: Array | None) -> Iterator[View]:
    """Yield the pictures, each with the sweep as from where the car stood when it was taken.

    Without poses the sweep is taken as it is: right where the picture was taken at the frame's time.
    """
    for frame, image in seen.items():
        points = drive.points(frame.index)
        # One LiDAR only, the one of most points: others sit elsewhere and see behind what this one sees.
        xyz_m = points.xyz_ego_m[points.sensor == np.bincount(points.sensor, minlength=1).argmax()]
        if poses is not None and image.time_ns != frame.time_ns and len(poses) > 1:
            at_picture, at_frame = (
                pose_at([frame.time_ns for frame in drive.frames], poses, t)
                for t in (image.time_ns, frame.time_ns)
            )
            xyz_m = apply(inverse(at_picture) @ at_frame, xyz_m)
        yield View(image.rgb, xyz_m)


def _calibration(camera: Camera, seen: Sequence[View]) -> Finding:
    """What the pictures and sweeps of a camera say of its calibration."""
    found = offset(camera, seen)
    if found is None:
        return Finding(camera.name, f"too few outlines in {len(seen)} pictures to check the calibration")
    if found.is_off:
        told = " and ".join(_off(found))
        return Finding(camera.name, f"{told}: look at the calibration", faulty=True, offset=found)
    blind = [_bar(k) for k in range(6) if not found.tells(_FAULTS * (np.arange(6) == k))]
    text = "no fault seen in the calibration" + (f"; it would miss {', '.join(blind)}" if blind else "")
    return Finding(camera.name, text, offset=found)


def _off(found: Offset) -> Iterator[str]:
    """The axes along or about which a calibration is off, in words; at least the surest one."""
    sure = np.abs(found.six) / found.sigma
    off = (np.abs(found.six) > GOOD_ENOUGH) & (sure > 2)
    off[np.argmax(sure)] = True
    for k in np.flatnonzero(off):
        if k < 3:
            size, sigma = np.rad2deg([found.six[k], found.sigma[k]])
            yield f"rotated by {size:.2f} +- {sigma:.2f} degrees about {_AXES[k]}"
        else:
            size, sigma = found.six[k] * 100, found.sigma[k] * 100
            yield f"moved by {size:.1f} +- {sigma:.1f} cm along {_AXES[k - 3]}"


def _bar(k: int) -> str:
    return f"1 degree about {'xyz'[k]}" if k < 3 else f"5 cm along {'xyz'[k - 3]}"
