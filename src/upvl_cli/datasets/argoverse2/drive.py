"""One log of Argoverse 2: its sweeps, poses, cameras and pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from upvl_cli.datasets.argoverse2.calibration import INTRINSICS, MOUNTS, read_cameras
from upvl_cli.datasets.argoverse2.ground_height import (
    GroundHeights,
    ground_z_ego,
    height_files,
    read_heights,
)
from upvl_cli.datasets.argoverse2.poses import CityTrajectory, poses_at, read_trajectory
from upvl_cli.datasets.argoverse2.sweep import read_sweep
from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.numbered_files import describe_files, numbered_files
from upvl_cli.datasets.shared.paths import find
from upvl_cli.datasets.shared.pictures import SUFFIXES, check_picture_size, read_picture
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Floats, Frame, Image, Points

POSES = "city_SE3_egovehicle.feather"
SWEEPS, PICTURES = "sensors/lidar", "sensors/cameras"
CAMERAS = (
    "ring_front_center",
    "ring_front_left",
    "ring_front_right",
    "ring_side_left",
    "ring_side_right",
    "ring_rear_left",
    "ring_rear_right",
    "stereo_front_left",
    "stereo_front_right",
)
# The ego origin is the middle of the rear axle; a log of Pittsburgh has the ground of its map 0.33 m below.
_AXLE_HEIGHT_M = 0.33
_PERIOD_NS = 100_000_000  # of the LiDARs, 10 Hz


@dataclass(frozen=True, eq=False)
class ArgoverseDrive:
    """One log of Argoverse 2.

    It has all that a `Drive` has, and also:

    Attributes:
        folder: The folder of the log.
        trajectory: All poses of the log; None where it has none.
        sweeps: The file of each of `frames`.
        pictures: The picture of each camera for a frame: its file, named by its time.
        height_paths: The files of ground heights, where the log has them.
    """

    name: str
    folder: Path
    trajectory: CityTrajectory | None
    frames: tuple[Frame, ...]
    sweeps: Mapping[int, Path]
    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Mapping[int, tuple[int, Path]]]
    world_from_ego: Array | None
    height_paths: tuple[Path, Path] | None
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    ground_z_m: float = -_AXLE_HEIGHT_M
    skipped_points: dict[int, Mapping[str, int]] = field(default_factory=dict)

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame; raises `BadInput` where there is no such frame or its file is damaged."""
        points, self.skipped_points[frame] = read_sweep(of_frame(self.name, self.sweeps, frame))
        return points

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera nearest to a frame, or None where none is near.

        Raises:
            BadInput: There is no such frame or camera, or the file is damaged.
        """
        found = camera_of_name(self.name, self.cameras, camera)
        of_frame(self.name, self.sweeps, frame)
        if frame not in self.pictures[camera]:
            return None
        time_ns, path = self.pictures[camera][frame]
        return Image(read_picture(path, found.width_px, found.height_px, path), time_ns)

    def ground_z(self, frame: int, xyz_ego_m: Array) -> Floats:
        """Return (n,) height of the ground of the map at places, along the z axis of the ego; NaN where unknown.

        Args:
            frame: Index of the frame.
            xyz_ego_m: (n, 3) places in the ego axes of that frame.

        Raises:
            BadInput: The log has no ground heights or no poses.
        """
        of_frame(self.name, self.sweeps, frame)
        heights = self._heights
        if self.world_from_ego is None:
            raise self._without_ground(POSES)
        step = [known.index for known in self.frames].index(frame)
        return ground_z_ego(heights, self.world_from_ego[step], xyz_ego_m)

    @cached_property
    def _heights(self) -> GroundHeights:
        if self.height_paths is None:
            raise self._without_ground("ground heights (map/*_ground_height_surface____*.npy)")
        return read_heights(*self.height_paths)

    def _without_ground(self, what: str) -> BadInput:
        return BadInput(f'{self.folder} has no {what}; copy it, or set method = "estimate" in ground.toml')


def open_drive(folder: Path) -> ArgoverseDrive:
    """Return the drive of a log; raises `BadInput` where it has no sweep, or a file is not what it has to be."""
    skipped: Counter[str] = Counter()
    by_time = numbered_files(folder / SWEEPS, (".feather",))
    if not by_time:
        found = describe_files(folder / SWEEPS)
        raise BadInput(f"{folder} has no sweep: {found}; expected {SWEEPS}/<time in ns>.feather")
    trajectory = read_trajectory(folder / POSES) if (folder / POSES).is_file() else None
    frames = [Frame(index, time_ns) for index, time_ns in enumerate(by_time)]
    pose = None
    if trajectory is not None:
        pose, known = poses_at(trajectory, np.array(list(by_time)))
        skipped["sweep without pose"] = int((~known).sum())
        frames, pose = [frame for frame, is_known in zip(frames, known, strict=True) if is_known], pose[known]
        if not frames:
            raise BadInput(f"{folder / POSES} has no pose at the time of any sweep; copy the log again")
    checked = check_frames(frames, folder / SWEEPS)
    cameras, pictures = _cameras(folder, checked, skipped)
    heights = height_files(folder)
    tables = [folder / name for name in (POSES, INTRINSICS, MOUNTS)]
    images = {path for of_camera in pictures.values() for _, path in of_camera.values()}
    sweeps = {frame.index: by_time[frame.time_ns] for frame in checked}
    files = {*(path for path in tables if path.is_file()), *(heights or ()), *sweeps.values(), *images}
    return ArgoverseDrive(
        name=folder.name,
        folder=folder,
        trajectory=trajectory,
        frames=checked,
        sweeps=sweeps,
        cameras=cameras,
        pictures=pictures,
        world_from_ego=pose,
        height_paths=heights,
        skipped={reason: count for reason, count in skipped.items() if count},
        files=tuple(sorted(files)),
    )


def _cameras(
    folder: Path, frames: Sequence[Frame], skipped: Counter[str]
) -> tuple[tuple[Camera, ...], dict[str, dict[int, tuple[int, Path]]]]:
    """Return the cameras that have pictures and a calibration, and their pictures by frame."""
    calibrated = read_cameras(folder)
    names = [path.name for path in find(folder, [f"{PICTURES}/*"]) if path.is_dir()]
    cameras, pictures = [], {}
    for name in sorted(names, key=lambda name: (name not in CAMERAS, *_place(name))):
        by_time = numbered_files(folder / PICTURES / name, SUFFIXES)
        camera = calibrated.get(name)
        if by_time and camera is None:
            skipped[f"{name} picture without calibration"] += len(by_time)
        elif by_time and camera is not None:
            first = by_time[min(by_time)]
            check_picture_size(first, camera.width_px, camera.height_px, first)
            cameras.append(camera)
            pictures[name] = _nearest(by_time, frames)
            skipped[f"no {name} picture"] += len(frames) - len(pictures[name])
    return tuple(cameras), pictures


def _place(name: str) -> tuple[int, str]:
    return (CAMERAS.index(name) if name in CAMERAS else 0), name


def _nearest(by_time: Mapping[int, Path], frames: Sequence[Frame]) -> dict[int, tuple[int, Path]]:
    """Return for each frame the picture nearest in time, within half the time from sweep to sweep."""
    times = np.array(list(by_time), dtype=np.int64)
    sweep_ns = np.array([frame.time_ns for frame in frames], dtype=np.int64)
    period_ns = float(np.median(np.diff(sweep_ns))) if len(frames) > 1 else _PERIOD_NS
    after = np.clip(np.searchsorted(times, sweep_ns), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    is_after = np.abs(times[after] - sweep_ns) < np.abs(sweep_ns - times[before])
    nearest = times[np.where(is_after, after, before)]
    near = np.abs(nearest - sweep_ns) <= period_ns / 2
    return {
        frame.index: (time_ns, by_time[time_ns])
        for frame, time_ns, is_near in zip(frames, nearest.tolist(), near, strict=True)
        if is_near
    }
