"""Drives with something wrong on purpose: what `bench/drive_check.py` tries the checks on.

A fault is a function from a drive to a drive. `FAULTS` names them, with words that the check should say of each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from upvl_cli.datasets.shared.motion_compensation import compensate

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import from_yaw, inverse, yaw_of
from upvl_cli.types import Array, Camera, Drive, Frame, Image, Points

FOOT = 0.3048


def _same(_: int, points: Points) -> Points:
    return points


@dataclass(frozen=True, eq=False)
class ChangedDrive:
    """A drive (a `Drive`) of which some is replaced.

    Attributes:
        drive: The drive as it is.
        frames: Its frames.
        world_from_ego: Its poses, or None.
        move: Changes the points of a frame.
        source: The frame that the points of each frame are taken from, by index; itself where it is not there.
    """

    drive: Drive
    frames: tuple[Frame, ...]
    world_from_ego: Array | None
    move: Callable[[int, Points], Points] = _same
    source: Mapping[int, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the segment."""
        return self.drive.name

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras as they are."""
        return self.drive.cameras

    @property
    def skipped(self) -> Mapping[str, int]:
        """What was left out."""
        return self.drive.skipped

    @property
    def ground_z_m(self) -> float:
        """Height of the road as the drive says."""
        return self.drive.ground_z_m

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the drive."""
        return self.drive.files

    def points(self, frame: int) -> Points:
        """Return the changed sweep of a frame."""
        return self.move(frame, self.drive.points(self.source.get(frame, frame)))

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a frame as it is."""
        return self.drive.image(frame, camera)


Fault = Callable[[Drive], Drive]


def with_poses(drive: Drive, world_from_ego: Array) -> Drive:
    """Return the drive with other poses; a reader that moves points by poses takes these too."""
    if is_dataclass(drive) and hasattr(drive, "untwist"):
        return replace(drive, world_from_ego=world_from_ego)  # type: ignore[type-var,return-value]
    if isinstance(drive, ChangedDrive):
        return replace(drive, world_from_ego=world_from_ego)
    return ChangedDrive(drive, drive.frames, world_from_ego)


def with_points(drive: Drive, move: Callable[[int, Points], Points]) -> Drive:
    """Return the drive with changed points; its reader moves them by its own poses before."""
    return ChangedDrive(drive, drive.frames, drive.world_from_ego, move)


def poses_of(drive: Drive) -> Array:
    """Return a copy of the poses of a drive that has some."""
    assert drive.world_from_ego is not None
    return np.array(drive.world_from_ego, dtype=np.float64)


def times_ns(drive: Drive) -> list[int]:
    """Return the times of all frames."""
    return [frame.time_ns for frame in drive.frames]


# Poses


def map_positions(drive: Drive, change: Callable[[Array], Array]) -> Drive:
    """Return the drive with other positions and the same rotations."""
    poses = poses_of(drive)
    poses[:, :3, 3] = change(poses[:, :3, 3])
    return with_poses(drive, poses)


def map_yaw(drive: Drive, change: Callable[[Array], Array]) -> Drive:
    """Return the drive with other headings, and the same positions, roll and pitch."""
    poses = poses_of(drive)
    yaw = yaw_of(poses)
    turn = from_yaw(change(yaw) - yaw, np.zeros((len(poses), 3)))
    poses[:, :3, :3] = turn[:, :3, :3] @ poses[:, :3, :3]
    return with_poses(drive, poses)


def angles_scaled(drive: Drive, factor: float) -> Drive:
    """Return the drive with yaw, pitch and roll times a factor."""
    poses = poses_of(drive)
    angles = np.unwrap(Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX"), axis=0)
    poses[:, :3, :3] = Rotation.from_euler("ZYX", factor * angles).as_matrix()
    return with_poses(drive, poses)


def inverse_poses(drive: Drive) -> Drive:
    """Return the drive with ego_from_world as poses."""
    return with_poses(drive, inverse(poses_of(drive)))


def one_pose(drive: Drive) -> Drive:
    """Return the drive with its first pose for all frames."""
    poses = poses_of(drive)
    return with_poses(drive, np.broadcast_to(poses[0], poses.shape).copy())


def held_poses(drive: Drive, each: int) -> Drive:
    """Return the drive with poses that change in each so many frames only."""
    poses = poses_of(drive)
    return with_poses(drive, poses[np.arange(len(poses)) // each * each])


def jump(drive: Drive, meters: float) -> Drive:
    """Return the drive with one pose off, in the middle of the drive."""
    poses = poses_of(drive)
    poses[len(poses) // 2, :3, 3] += meters * poses[len(poses) // 2, :3, 1]
    return with_poses(drive, poses)


def rounded(drive: Drive, meters: float) -> Drive:
    """Return the drive with positions rounded to so many metres."""
    return map_positions(
        drive, lambda xyz: np.column_stack([np.rint(xyz[:, :2] / meters) * meters, xyz[:, 2]])
    )


def other_pose_axes(drive: Drive, turn: Array) -> Drive:
    """Return the drive with poses of other axes of the car: rows of `turn` are these in ego axes."""
    poses = poses_of(drive)
    poses[:, :3, :3] = poses[:, :3, :3] @ np.asarray(turn, dtype=np.float64).T
    return with_poses(drive, poses)


def late_poses(drive: Drive, seconds: float) -> Drive:
    """Return the drive whose pose of a frame is where the car was so many seconds before."""
    poses, times = poses_of(drive), times_ns(drive)
    return with_poses(drive, np.array([pose_at(times, poses, time - round(seconds * 1e9)) for time in times]))


def frames_late(drive: Drive, frames: int) -> Drive:
    """Return the drive, without its first frames, whose pose of a frame is that of a frame before."""
    poses = poses_of(drive)
    return with_poses(ChangedDrive(drive, drive.frames[frames:], poses), poses[:-frames])


# Points


def map_points(drive: Drive, matrix: Array) -> Drive:
    """Return the drive with its points times a matrix: other axes or another unit."""

    def move(_: int, points: Points) -> Points:
        return replace(points, xyz_ego_m=points.xyz_ego_m @ np.asarray(matrix, dtype=np.float32).T)

    return with_points(drive, move)


def compensated_again(drive: Drive, share: float) -> Drive:
    """Return the drive with motion compensation done once more (1) or undone (-1)."""
    poses, times = poses_of(drive), times_ns(drive)
    step_of = {frame.index: step for step, frame in enumerate(drive.frames)}

    def move(frame: int, points: Points) -> Points:
        offset_ns = share * points.time_offset_ns
        return replace(
            points, xyz_ego_m=compensate(points.xyz_ego_m, offset_ns, step_of[frame], times, poses)
        )

    return with_points(drive, move)


def without_offsets(drive: Drive) -> Drive:
    """Return the drive without times of its points."""

    def move(_: int, points: Points) -> Points:
        return replace(points, time_offset_ns=np.zeros(len(points), np.int64))

    return with_points(drive, move)


def reversed_sweeps(drive: Drive) -> Drive:
    """Return the drive whose sweeps come in reversed order."""
    numbers = [frame.index for frame in drive.frames]
    source = dict(zip(numbers, reversed(numbers), strict=True))
    return ChangedDrive(drive, drive.frames, drive.world_from_ego, source=source)


# Drives that are right, of another sensor or rate


def fewer_beams(drive: Drive, each: int, spacing_deg: float = 0.42) -> Drive:
    """Return the drive as seen by a LiDAR with each n-th beam, by the angle above the horizon."""

    def move(_: int, points: Points) -> Points:
        x, y, z = points.xyz_ego_m.T
        beam = np.floor(np.degrees(np.arctan2(z, np.hypot(x, y))) / spacing_deg).astype(int)
        return points[beam % each == 0]

    return with_points(drive, move)


def each_frame(drive: Drive, each: int) -> Drive:
    """Return each n-th frame of the drive."""
    poses = None if drive.world_from_ego is None else drive.world_from_ego[::each]
    return ChangedDrive(drive, drive.frames[::each], poses)


def field_of_view(drive: Drive, degrees: float) -> Drive:
    """Return the drive as seen by a LiDAR that looks forward only."""

    def move(_: int, points: Points) -> Points:
        azimuth = np.degrees(np.arctan2(points.xyz_ego_m[:, 1], points.xyz_ego_m[:, 0]))
        return points[np.abs(azimuth) < degrees / 2]

    return with_points(drive, move)


class Case(NamedTuple):
    """A fault, and words of which the check should say one of each group in a finding of that subject."""

    make: Fault
    subject: str
    words: tuple[str, ...]
    needs_poses: bool = True


_RIGHT_FORWARD_UP = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_CAMERA = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]

POSE_FAULTS: dict[str, Case] = {
    "path mirrored": Case(
        partial(map_positions, change=lambda xyz: xyz * [1, -1, 1]), "poses", ("path is mirrored",)
    ),
    "yaw = pi/2 - yaw": Case(partial(map_yaw, change=lambda yaw: np.pi / 2 - yaw), "poses", ("wrong sense",)),
    "x and y swapped": Case(
        partial(map_positions, change=lambda xyz: xyz[:, [1, 0, 2]]), "poses", ("swapped",)
    ),
    "heading + 90": Case(
        partial(map_yaw, change=lambda yaw: yaw + np.pi / 2), "poses", ("turned by", "axes")
    ),
    "inverse": Case(inverse_poses, "poses", ("ego_from_world",)),
    "one pose for all": Case(one_pose, "poses", ("repeated for all",)),
    "poses at half the rate": Case(partial(held_poses, each=2), "poses", ("lower rate",)),
    "jump of 3 m": Case(partial(jump, meters=3.0), "poses", ("jump",)),
    "rounded to 1.1 m": Case(partial(rounded, meters=1.11), "poses", ("rounded",)),
    "degrees for radians": Case(partial(angles_scaled, factor=180 / np.pi), "poses", ("degrees",)),
    "radians for degrees": Case(
        partial(angles_scaled, factor=np.pi / 180), "poses", ("radians where degrees",)
    ),
    "poses x 3.28": Case(partial(map_positions, change=lambda xyz: xyz / FOOT), "poses", ("in feet",)),
    "poses x 0.001": Case(partial(map_positions, change=lambda xyz: xyz * 0.001), "poses", ("kilometres",)),
    "pose axes y forward": Case(partial(other_pose_axes, turn=_RIGHT_FORWARD_UP), "poses", ("axes",)),
    "pose axes of a camera": Case(partial(other_pose_axes, turn=_CAMERA), "poses", ("axes",)),
    "a frame late": Case(partial(frames_late, frames=1), "poses", ("late",)),
    "50 ms late": Case(partial(late_poses, seconds=0.05), "poses", ("late",)),
    "0.3 s early": Case(partial(late_poses, seconds=-0.3), "poses", ("early",)),
    "sweeps reversed": Case(reversed_sweeps, "poses", ("opposite order",)),
}
POINT_FAULTS: dict[str, Case] = {
    "points x 3.28": Case(partial(map_points, matrix=np.eye(3) / FOOT), "poses", ("in feet",)),
    "points x 100": Case(partial(map_points, matrix=np.eye(3) * 100), "poses", ("centimetres",)),
    "points y forward": Case(
        partial(map_points, matrix=_RIGHT_FORWARD_UP), "axes", ('"y", "-x", "z"',), False
    ),
    "points turned by 180": Case(partial(map_points, matrix=_HALF_TURN), "poses", ('"-x", "-y", "z"',)),
    "points mirrored": Case(partial(map_points, matrix=np.diag([1, -1, 1])), "poses", ("left and right",)),
    "points of a camera": Case(partial(map_points, matrix=_CAMERA), "axes", ('"z", "-x", "-y"',), False),
    "points z down": Case(
        partial(map_points, matrix=np.diag([1, -1, -1])), "axes", ('"x", "-y", "-z"',), False
    ),
    "points turned by 45": Case(
        partial(map_points, matrix=from_yaw(np.pi / 4, np.zeros(3))[:3, :3]), "axes", ("off its axis",), False
    ),
    "compensation undone": Case(partial(compensated_again, share=-1.0), "motion compensation", ("not done",)),
    "compensation twice": Case(partial(compensated_again, share=1.0), "motion compensation", ("twice",)),
}
FAULTS = POSE_FAULTS | POINT_FAULTS
