"""One drive in any of KITTI's layouts: its frames, and what they hold.

Ego axes are those of the LiDAR.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from upvl_cli.datasets.kitti import twist as kitti_twist
from upvl_cli.datasets.kitti.calibration import Calibration
from upvl_cli.datasets.kitti.pictures import Picture
from upvl_cli.datasets.kitti.sweeps import Vehicle, measure_vehicle, read_sweep, reflectance, without_car
from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.numbered_files import describe_files
from upvl_cli.datasets.shared.pictures import read_picture
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Frame, Image, Points

# A recording of KITTI's own, and so of its car.
_KITTIS_NAME = re.compile(r"2011_\d\d_\d\d_drive_\d{4}_(sync|extract)")

Layout = Literal["raw", "object", "tracking", "odometry", "kitti360"]


@dataclass(frozen=True, eq=False)
class KittiDrive:
    """One drive of KITTI's.

    It has all that a `Drive` has, and also:

    Attributes:
        folder: The folder of the drive: of a raw recording, of the split of objects, of the sweeps of a tracking
            sequence, or of an odometry sequence.
        layout: Which of KITTI's data sets it is laid out as.
        calibration: What the calibration files give.
        sweeps: The LiDAR file of each of `frames`.
        pictures: The pictures of each camera, by frame.
        turn_s: Seconds that the LiDAR takes to turn once; 0 where unknown.
        is_compensated: Whether the files hold points where they were at the frame's time.
        is_view_of_delft: Whether it is of View-of-Delft, whose car is another one.
        skipped_points: How many points were left out of each sweep that was read, by frame and reason.
    """

    name: str
    folder: Path
    layout: Layout
    calibration: Calibration
    frames: tuple[Frame, ...]
    sweeps: Mapping[int, Path]
    turn_s: float
    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Mapping[int, Picture]]
    world_from_ego: Array | None
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    is_compensated: bool = False
    is_view_of_delft: bool = False
    skipped_points: dict[int, Mapping[str, int]] = field(default_factory=dict)

    @cached_property
    def vehicle(self) -> Vehicle:
        """The car and its LiDAR, by a few sweeps."""
        is_kittis = None
        if self.is_view_of_delft:
            is_kittis = False
        elif self.layout == "raw" and _KITTIS_NAME.fullmatch(self.name):
            is_kittis = True
        return measure_vehicle(list(self.sweeps.values()), is_kittis=is_kittis)

    @property
    def ground_z_m(self) -> float:
        """Height of the road in ego axes, roughly."""
        return self.vehicle.ground_z_m

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame without the car itself, motion-compensated where the drive has poses.

        Raises:
            BadInput: There is no such frame, or its file is damaged.
        """
        points, offset_s = self._read(frame)
        return replace(points, xyz_ego_m=self._untwist(frame, points.xyz_ego_m, offset_s))

    def measured_points(self, frame: int) -> Points | None:
        """Return the sweep of a frame with each point where it was measured; None where the files do not hold that.

        Raises:
            BadInput: There is no such frame, or its file is damaged.
        """
        return None if self.is_compensated else self._read(frame)[0]

    def _read(self, frame: int) -> tuple[Points, Array]:
        """Return the sweep of a frame as its file has it, and the seconds after the frame's time of each point."""
        rows, self.skipped_points[frame] = read_sweep(of_frame(self.name, self.sweeps, frame))
        values = without_car(rows, self.vehicle)
        xyz_ego_m, total = np.ascontiguousarray(values[:, :3]), len(values)
        offset_s = kitti_twist.offsets_s(xyz_ego_m, turn_s=self.turn_s)
        points = Points(
            xyz_ego_m=xyz_ego_m,
            intensity=reflectance(values, self.vehicle),
            elongation=np.zeros(total, np.float32),
            sensor=np.zeros(total, np.uint8),
            time_offset_ns=offset_s * 1e9,
        )
        return points, offset_s

    def untwist(self, frame: int, xyz_ego_m: Array) -> Array:
        """Return places that the turning LiDAR saw, as from where the car stood at the frame's time.

        Args:
            frame: Index of the frame.
            xyz_ego_m: (n, 3) places; without poses they stay what they are.
        """
        return self._untwist(frame, xyz_ego_m, kitti_twist.offsets_s(xyz_ego_m, turn_s=self.turn_s))

    def _untwist(self, frame: int, xyz_ego_m: Array, offset_s: Array) -> Array:
        if self.world_from_ego is None or self.is_compensated:
            return xyz_ego_m
        step = [known.index for known in self.frames].index(frame)
        near = slice(max(step - 1, 0), step + 2)
        time_ns = np.array([known.time_ns for known in self.frames[near]])
        twists = kitti_twist.twists(time_ns, self.world_from_ego[near])
        return kitti_twist.untwist(xyz_ego_m, twists[step - near.start], offset_s)

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera such as `image_02`, or None where it is missing.

        Raises:
            BadInput: There is no such camera, or the file is damaged.
        """
        found = camera_of_name(self.name, self.cameras, camera)
        picture = self.pictures[camera].get(frame)
        if picture is None:
            return None
        rgb = read_picture(picture.path, found.width_px, found.height_px, picture.path)
        return Image(rgb, picture.time_ns)


def complete_frames(
    sweeps: Mapping[int, Path],
    times: Mapping[int, int],
    needed: Mapping[str, Collection[int]],
    skipped: Counter[str],
    folder: Path,
    times_path: Path,
) -> tuple[Frame, ...]:
    """Return the frames that have a sweep, a time and all else that is needed; the others are counted.

    Args:
        sweeps: The sweeps by frame number.
        times: The time of each frame number.
        needed: What else a frame must have ("oxts record"), and the numbers that have it.
        skipped: The counts, by reason.
        folder: The folder of the sweeps, for the message.
        times_path: The file of the times, for the message.

    Raises:
        BadInput: No frame is complete, or their times do not ascend.
    """
    frames = []
    for number in sorted({*sweeps, *times}):
        missing = next((what for what, known in needed.items() if number not in known), None)
        if number not in sweeps:
            skipped["no sweep"] += 1
        elif number not in times:
            skipped["sweep without time stamp"] += 1
        elif missing:
            skipped[f"sweep without {missing}"] += 1
        else:
            frames.append(Frame(number, times[number]))
    if not frames:
        reasons = ", ".join(f"{count} {reason}" for reason, count in skipped.items()) or "no sweep"
        raise BadInput(
            f"{folder} has no complete frame ({reasons}): {describe_files(folder)}; expected sweeps like "
            "0000000000.bin, each with a time stamp"
        )
    return check_frames(frames, times_path)
