"""KITTI-360 (`data_3d_raw/<drive>`): sweeps, the two rectified front cameras and poses; no labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti import twist
from upvl_cli.datasets.kitti.calibration import (
    Calibration,
    CalibrationFields,
    picture_size_px,
    rectified_camera,
)
from upvl_cli.datasets.kitti.drive import KittiDrive, complete_frames
from upvl_cli.datasets.kitti.pictures import picture_files, sizes_px
from upvl_cli.datasets.kitti.raw import read_pictures, sweep_times
from upvl_cli.datasets.kitti.timestamps import read_lines
from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbered_files import numbered_files
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose, rigid
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

FOLDER = "data_3d_raw"
_CAMERAS = ("image_00", "image_01")  # the others are fisheyes of a model of their own (MEI)
_MAX_FRAME = 10**9


def open_kitti360(folder: Path) -> KittiDrive:
    """Return the drive of a folder in `data_3d_raw`.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    root, name = folder.parent.parent, folder.name
    pictures_root = root / "data_2d_raw" / name
    files = picture_files({camera: pictures_root / camera / "data_rect" for camera in _CAMERAS})
    calibration = _read_calibration(root / "calibration", sizes_px(files))
    sweep_folder = folder / "velodyne_points/data"
    sweeps = numbered_files(sweep_folder, (".bin",))
    times_path = folder / "velodyne_points/timestamps.txt"
    times = sweep_times(times_path, sweeps)
    poses_path = root / "data_poses" / name / "poses.txt"
    has_poses = calibration.ego_from_imu is not None and poses_path.is_file()
    poses = _read_poses(poses_path) if has_poses else {}
    needed = {"pose": poses} if poses else {}
    frames = complete_frames(sweeps, times, needed, skipped, sweep_folder, times_path)
    cameras, pictures, time_files = read_pictures(pictures_root, files, calibration, frames, skipped)
    world_from_ego = None
    if poses and calibration.ego_from_imu is not None:
        world_from_imu = np.stack([poses[frame.index] for frame in frames])
        world_from_ego = world_from_imu @ np.linalg.inv(calibration.ego_from_imu)
    others = [times_path, *time_files, *([poses_path] if poses else [])]
    images = (picture.path for of_camera in pictures.values() for picture in of_camera.values())
    return KittiDrive(
        name=name,
        folder=folder,
        layout="kitti360",
        calibration=calibration,
        frames=frames,
        sweeps={frame.index: sweeps[frame.index] for frame in frames},
        turn_s=twist.turn_s(times),
        cameras=cameras,
        pictures=pictures,
        world_from_ego=world_from_ego,
        skipped=dict(skipped),
        files=tuple(sorted({*calibration.files, *others, *sweeps.values(), *images})),
    )


def _read_calibration(folder: Path, found_px: Mapping[str, tuple[int, int]]) -> Calibration:
    """Return what the three files give: camera 0 to LiDAR, cameras to inertial unit, the cameras' projections."""
    paths = [folder / name for name in ("calib_cam_to_velo.txt", "calib_cam_to_pose.txt", "perspective.txt")]
    if not all(path.is_file() for path in paths):
        return Calibration(None, None, {}, ())
    velo_path, imu_path, projections_path = paths
    row = numbers(read_text(velo_path), 12, str(velo_path)).reshape(3, 4)
    ego_from_camera0 = check_pose(row, str(velo_path), max_m=MAX_ON_CAR_M)
    mounts, projections = CalibrationFields(imu_path), CalibrationFields(projections_path)
    ego_from_imu = ego_from_camera0 @ np.linalg.inv(mounts.matrix("image_00"))
    cameras = {}
    for name in _CAMERAS:
        number = name[-2:]
        if name in mounts and f"P_rect_{number}" in projections:
            rect_from_camera = rigid(projections.rotation(f"R_rect_{number}"), np.zeros(3))
            rect_from_ego = rect_from_camera @ np.linalg.inv(ego_from_imu @ mounts.matrix(name))
            key = f"S_rect_{number}"
            size_px = picture_size_px(projections, key) if key in projections else found_px.get(name)
            cameras[name] = rectified_camera(
                projections, f"P_rect_{number}", rect_from_ego, name, size_px, is_reference=True
            )
    return Calibration(None, ego_from_imu, cameras, tuple(paths))


def _read_poses(path: Path) -> dict[int, Array]:
    """Return the (4, 4) pose of the inertial unit of each frame number that has one: it has none while it stands."""
    poses: dict[int, Array] = {}
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        values = numbers(line, 13, where)
        if not 0 <= values[0] < _MAX_FRAME or values[0] != int(values[0]):
            raise BadInput(
                f"{where} begins with {values[0]:g}, expected the number of a frame; copy the file again"
            )
        poses[int(values[0])] = check_pose(values[1:].reshape(3, 4), where)
    return poses
