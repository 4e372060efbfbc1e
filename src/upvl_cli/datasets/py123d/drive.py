"""One log of py123d as a drive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from py123d.datatypes import ModalityType

from upvl_cli.datasets.py123d.cameras import check_first_picture, read_camera, read_image
from upvl_cli.datasets.py123d.library import ArrowLog, library_errors, open_log, pose_matrices
from upvl_cli.datasets.py123d.points import CarOutline, car_outline, read_sweep
from upvl_cli.datasets.shared.folders import local_folder
from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.types import Array, Camera, Frame, Image, Points, concat

_MERGED = "lidar.lidar_merged"
_MAX_POSE_GAP_US = 500_000  # half a second: a pose between two states farther apart is a guess


@dataclass(frozen=True, eq=False)
class Py123dDrive:
    """A log of py123d; the index of a frame is its iteration in the log.

    It has all that a `Drive` has, and also:

    Attributes:
        log: The log.
        lidars: Its LiDARs; the frames are those in which the first has a sweep.
        outline: The car itself, whose points are dropped; None where nothing is known.
    """

    name: str
    log: ArrowLog
    frames: tuple[Frame, ...]
    cameras: tuple[Camera, ...]
    skipped: Mapping[str, int]
    world_from_ego: Array | None
    files: tuple[Path, ...]
    lidars: tuple[str, ...]
    outline: CarOutline | None

    @cached_property
    def ground_z_m(self) -> float:
        """Height of the road below the car, measured in the first sweep."""
        return road_height_m(self.points(self.frames[0].index).xyz_ego_m)

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame, of all LiDARs.

        Raises:
            BadInput: There is no such frame, or its sweep is damaged.
        """
        known = self._frame(frame)
        sweeps = (read_sweep(self.log, key, known, self.outline) for key in self.lidars)
        return concat([sweep for sweep in sweeps if sweep is not None], Points)

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera, or None where it is missing.

        Raises:
            BadInput: There is no such camera or frame, or the picture is damaged.
        """
        found = camera_of_name(self.name, self.cameras, camera)
        return read_image(self.log, self._frame(frame).index, found)

    def _frame(self, index: int) -> Frame:
        return of_frame(self.name, self._frame_by_index, index)

    @cached_property
    def _frame_by_index(self) -> dict[int, Frame]:
        return {frame.index: frame for frame in self.frames}


def open_drive(folder: Path, segment: str) -> Py123dDrive:
    """Return a drive; neither sweeps nor pictures are read yet.

    Args:
        folder: The folder of the log.
        segment: Name of the drive.

    Raises:
        BadInput: The log is damaged, or has no sweep.
    """
    log, skipped = open_log(local_folder(folder)), Counter[str]()
    lidars = sorted(log.keys(ModalityType.LIDAR), key=lambda key: (key != _MERGED, key))
    if not lidars:
        raise BadInput(f"{folder} has no LiDAR; expected {_MERGED}.arrow or another lidar.*.arrow in it")
    ego = ModalityType.EGO_STATE_SE3.serialize()
    has_ego = ego in log.metadatas
    if has_ego:
        log.table(ego)
    frames = _frames_of_sweeps(log, lidars[0], skipped)
    poses = None
    if has_ego:
        states = [_ego_states(log, ego, frame) for frame in frames]
        if not all(states):
            skipped["sweep without an ego state"] += sum(not near for near in states)
        frames = [frame for frame, near in zip(frames, states, strict=True) if near]
        poses = _ego_poses(frames, [near for near in states if near], f"{log.path(ego)}: imu_se3")
    if not frames:
        raise BadInput(
            f"{folder} has no frame to read: none of its iterations has a sweep in {lidars[0]}.arrow"
            + (f" and a state in {ego}.arrow" if has_ego else "")
        )
    cameras = _cameras(log, [frame.index for frame in frames], skipped)
    keys = ("sync", *lidars, *([ego] if has_ego else ()), *(f"camera.{camera.name}" for camera in cameras))
    files = [folder / log.path(key).name for key in keys]
    files += [video for path in files if (video := path.with_suffix(".mp4")).is_file()]
    return Py123dDrive(
        segment,
        log,
        check_frames(frames, folder / "sync.arrow"),
        cameras,
        dict(skipped),
        poses,
        tuple(files),
        tuple(lidars),
        car_outline(log.metadatas[ego], str(log.path(ego))) if has_ego else None,
    )


def _frames_of_sweeps(log: ArrowLog, lidar: str, skipped: Counter[str]) -> list[Frame]:
    """Return a frame for each iteration with a sweep of its own.

    Its time is that of the iteration where the sweep lasts across it, else that of the start of the sweep.
    """
    with library_errors(log.path("sync")):
        synced_us = [int(time.time_us) for time in log.scene.get_all_iteration_timestamps()]
    starts_us, ends_us = log.times_us(lidar), log.times_us(lidar, "end_timestamp_us")
    frames, last_us = [], None
    for iteration, (sync_us, start_us, end_us) in enumerate(zip(synced_us, starts_us, ends_us, strict=True)):
        if start_us is None:
            skipped["iteration without a sweep"] += 1
        elif start_us == last_us:
            skipped["iteration with the sweep of the one before"] += 1
        else:
            across = end_us is not None and start_us <= sync_us <= end_us
            frames.append(Frame(iteration, 1000 * (sync_us if across else start_us)))
            last_us = start_us
    return frames


def _ego_states(log: ArrowLog, ego: str, frame: Frame) -> dict[int, Array]:
    """Return the pose (7 numbers) of the state at a frame, or of those before and after it, by time (us).

    Nothing is returned where no state is near.
    """
    time_us = frame.time_ns // 1000
    with library_errors(f"{log.path(ego)}, iteration {frame.index}"):
        state = log.scene.get_ego_state_se3_at_iteration(frame.index)
        near = [state]
        if state is None or state.timestamp.time_us != time_us:
            near = [
                log.scene.get_ego_state_se3_at_timestamp(time_us, criteria=side)
                for side in ("backward", "forward")
            ]
        states = {int(known.timestamp.time_us): known.imu_se3.array for known in near if known is not None}
    if any(abs(time - time_us) > _MAX_POSE_GAP_US for time in states):
        return {}
    return {time: np.array(states[time], dtype=np.float64) for time in sorted(states)}


def _ego_poses(frames: list[Frame], states: list[dict[int, Array]], where: str) -> Array:
    """Return (T, 4, 4) world_from_ego: of the state at each frame, or on the way between the two around it."""
    numbers = [pose for near in states for pose in near.values()]
    found = iter(pose_matrices(np.array(numbers).reshape(-1, 7), where))
    poses = []
    for frame, near in zip(frames, states, strict=True):
        times_ns = [1000 * time for time in near]
        poses.append(pose_at(times_ns, np.array([next(found) for _ in near]), frame.time_ns))
    return np.array(poses).reshape(-1, 4, 4)


def _cameras(log: ArrowLog, frames: list[int], skipped: Counter[str]) -> tuple[Camera, ...]:
    """Return the cameras with pictures and a lens that can be used."""
    cameras = []
    for key in log.keys(ModalityType.CAMERA):
        times_us = log.times_us(key)
        camera = read_camera(log.metadatas[key], key, str(log.path(key)))
        if camera is None:
            skipped[f"{key} without a calibration that can be used"] += 1
            continue
        taken = [frame for frame in frames if times_us[frame] is not None]
        if taken:
            check_first_picture(log, taken[0], camera)
            cameras.append(camera)
        if taken and len(taken) < len(frames):
            skipped[f"no {camera.name} picture"] += len(frames) - len(taken)
    return tuple(cameras)
