"""Writers of KITTI's other layouts, and of View-of-Delft, around the street of `tiny_kitti`: all is known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tiny_kitti import (
    CAMERA_DELAY_NS,
    CAR_LWH_M,
    CAR_SPEED_MPS,
    CAR_START_M,
    EGO_SPEED_MPS,
    HEIGHT_PX,
    IMU_TO_VELO_R,
    IMU_TO_VELO_T,
    P_RECT,
    R_RECT,
    VELO_TO_CAM_R,
    VELO_TO_CAM_T,
    WIDTH_PX,
    draw,
    ego_poses,
    numbers,
    street_points,
    turn,
    twisted,
    write_fields,
    write_oxts,
    write_times,
)

STEP_S = 0.1
# View-of-Delft's camera looks down by seven degrees.
TILTED_R = turn(0, -0.12) @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
TILTED_T = np.array([0.15, -0.46, -0.91])


@dataclass(frozen=True)
class TinySequence:
    """What is true in a drive, by step."""

    root: Path
    folder: Path
    segment: str
    numbers: list[int]
    world_from_ego: np.ndarray  # (T, 4, 4), the first ego at the origin
    xyz_ego_m: list[np.ndarray]
    car: np.ndarray  # (T, 7) rows of its boxes


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


RECT_FROM_EGO = rigid(R_RECT, np.zeros(3)) @ rigid(VELO_TO_CAM_R, VELO_TO_CAM_T)
TILTED_FROM_EGO = rigid(TILTED_R, TILTED_T)


def write_object(
    root: Path,
    numbers_: Sequence[int] = (0, 1, 2, 3),
    *,
    split: str = "training",
    suffix: str = ".png",
    delft: bool = False,
    digits: int = 6,
) -> TinySequence:
    """Write `<split>/{velodyne,calib,image_2,label_2}`, of View-of-Delft also `pose` and 8-bit reflectance."""
    folder = root / split
    truth = _truth(root, folder, folder.name, numbers_)
    rect_from_ego = TILTED_FROM_EGO if delft else RECT_FROM_EGO
    for step, number in enumerate(numbers_):
        stem = f"{number:0{digits}d}"
        _write_sweep(folder / "velodyne" / f"{stem}.bin", truth, step, full=255 if delft else 1)
        write_text(folder / "calib" / f"{stem}.txt", calibration_text(rect_from_ego))
        picture(folder / "image_2" / f"{stem}{suffix}", truth.car[step, :3])
        line = object_line("Car", truth.car[step], rect_from_ego, about_lidar=delft)
        write_text(folder / "label_2" / f"{stem}.txt", line)
        if delft:
            camera = truth.world_from_ego[step] @ np.linalg.inv(rect_from_ego)
            names = ("odomToCamera", "mapToCamera", "UTMToCamera")
            lines = [json.dumps({name: camera.ravel().tolist()}) for name in names]
            write_text(folder / "pose" / f"{stem}.json", "\n".join(lines))
    return truth


def write_tracking(
    root: Path, numbers_: Sequence[int] = (0, 1, 2, 3), sequence: str = "0000"
) -> TinySequence:
    """Write a sequence of `training`, its sweeps as the turning LiDAR saw them."""
    split = root / "training"
    truth = _truth(root, split / "velodyne" / sequence, f"training-{sequence}", numbers_)
    labels = [f"0 -1 DontCare{' -1' * 14}\n"]
    for step, number in enumerate(numbers_):
        _write_sweep(truth.folder / f"{number:06d}.bin", truth, step, is_twisted=True)
        picture(split / "image_02" / sequence / f"{number:06d}.png", truth.car[step, :3])
        seen = truth.car[step].copy()
        seen[:3] = twisted(seen[None, :3], STEP_S)[0]
        labels.append(f"{number} 7 {object_line('Van', seen, RECT_FROM_EGO)}")
    write_text(split / "label_02" / f"{sequence}.txt", "".join(labels))
    text = calibration_text(RECT_FROM_EGO)
    for old, new in (
        ("R0_rect:", "R_rect"),
        ("Tr_velo_to_cam:", "Tr_velo_cam"),
        ("Tr_imu_to_velo:", "Tr_imu_velo"),
    ):
        text = text.replace(old, new)
    write_text(split / "calib" / f"{sequence}.txt", text)
    records = root / "records"
    write_oxts(records, ego_poses(STEP_S * np.arange(numbers_[-1] + 1)))
    lines = [path.read_text() for path in sorted(records.iterdir())]
    write_text(split / "oxts" / f"{sequence}.txt", "".join(lines))
    for path in records.iterdir():
        path.unlink()
    records.rmdir()
    return truth


def write_odometry(
    root: Path, numbers_: Sequence[int] = (0, 1, 2, 3), *, poses_inside: bool = False
) -> TinySequence:
    """Write `dataset/sequences/00` with `poses/00.txt` (KITTI), or `poses.txt` in it (SemanticKITTI)."""
    folder = root / "dataset/sequences/00"
    truth = _truth(root, folder, "00", numbers_)
    for step, number in enumerate(numbers_):
        _write_sweep(folder / "velodyne" / f"{number:06d}.bin", truth, step)
        picture(folder / "image_2" / f"{number:06d}.png", truth.car[step, :3])
    text = calibration_text(RECT_FROM_EGO, rectified=True).replace("Tr_velo_to_cam:", "Tr:")
    kept = [line for line in text.splitlines() if line[0] == "P" or line.startswith("Tr:")]
    write_text(folder / "calib.txt", "\n".join(kept))
    every = np.arange(numbers_[-1] + 1)
    write_text(folder / "times.txt", "".join(f"{STEP_S * number:e}\n" for number in every))
    world = ego_poses(STEP_S * every)
    first = world[0] @ np.linalg.inv(RECT_FROM_EGO)
    cameras = np.linalg.inv(first) @ world @ np.linalg.inv(RECT_FROM_EGO)
    path = folder / "poses.txt" if poses_inside else root / "dataset/poses/00.txt"
    write_text(path, "".join(f"{numbers(pose[:3])}\n" for pose in cameras))
    return truth


def write_kitti360(root: Path, numbers_: Sequence[int] = (0, 1, 2, 3)) -> TinySequence:
    """Write a drive of KITTI-360, its sweeps as the turning LiDAR saw them; the pose is that of the inertial unit."""
    name = "2013_05_28_drive_0000_sync"
    folder = root / "data_3d_raw" / name
    truth = _truth(root, folder, name, numbers_)
    start_ns = int(np.datetime64("2013-05-28T10:00:00", "ns").astype(np.int64))
    times_ns = start_ns + (1e9 * STEP_S * np.arange(numbers_[-1] + 1)).astype(np.int64)
    write_times(folder / "velodyne_points", times_ns)
    pictures = root / "data_2d_raw" / name / "image_00"
    write_times(pictures, times_ns + CAMERA_DELAY_NS)
    for step, number in enumerate(numbers_):
        _write_sweep(folder / f"velodyne_points/data/{number:010d}.bin", truth, step, is_twisted=True)
        picture(pictures / f"data_rect/{number:010d}.png", truth.car[step, :3])
    # The first camera sits where the rectified one does, but is turned.
    ego_from_rect = np.linalg.inv(
        rigid(np.eye(3), np.linalg.solve(P_RECT["02"][:, :3], P_RECT["02"][:, 3])) @ RECT_FROM_EGO
    )
    ego_from_camera = ego_from_rect @ rigid(R_RECT, np.zeros(3))
    ego_from_imu = rigid(turn(0, np.pi) @ IMU_TO_VELO_R, IMU_TO_VELO_T)  # its z axis is down
    write_text(root / "calibration/calib_cam_to_velo.txt", numbers(ego_from_camera[:3]))
    imu_from_camera = np.linalg.inv(ego_from_imu) @ ego_from_camera
    write_fields(root / "calibration/calib_cam_to_pose.txt", {"image_00": imu_from_camera[:3]})
    fields = {"S_rect_00": [WIDTH_PX, HEIGHT_PX], "R_rect_00": R_RECT, "P_rect_00": P_RECT["02"]}
    write_fields(root / "calibration/perspective.txt", {"calib_time": "28-May-2013", **fields})
    world_from_imu = truth.world_from_ego @ ego_from_imu
    lines = [f"{number} {numbers(pose[:3])}\n" for number, pose in zip(numbers_, world_from_imu, strict=True)]
    write_text(root / "data_poses" / name / "poses.txt", "".join(lines))
    return truth


def object_line(
    kind: str, box: np.ndarray, rect_from_ego: np.ndarray = RECT_FROM_EGO, *, about_lidar: bool = False
) -> str:
    """The box in KITTI's own terms: the middle of its floor, and its angle about the camera's y."""
    ego_from_rect = rect_from_ego[:3, :3].T
    length, width, height = box[3:6]
    if about_lidar:
        floor = rect_from_ego[:3, :3] @ (box[:3] - [0, 0, height / 2]) + rect_from_ego[:3, 3]
        angle = -box[6] - np.pi / 2
    else:
        floor = rect_from_ego[:3, :3] @ box[:3] + rect_from_ego[:3, 3] + [0, height / 2, 0]
        # The angle whose direction, in camera axes, is that of the heading seen from above.
        angle, reach = 0.0, np.pi
        for _ in range(3):  # all angles first, then those about the best one
            angles = angle + np.linspace(-reach, reach, 2001)
            along = np.column_stack([np.cos(angles), 0 * angles, -np.sin(angles)]) @ ego_from_rect.T
            error = np.angle(np.exp(1j * (np.arctan2(along[:, 1], along[:, 0]) - box[6])))
            angle, reach = float(angles[np.abs(error).argmin()]), reach / 500
    values = [0, 0, 0, 1, 2, 3, 4, height, width, length, *floor, angle]
    return f"{kind} {' '.join(map(str, values))}{' 1' if about_lidar else ''}\n"


def calibration_text(rect_from_ego: np.ndarray, *, rectified: bool = False) -> str:
    """The one file of the object set: its rotation in two parts, as R0_rect and Tr."""
    r_rect = np.eye(3) if rectified else R_RECT
    velo_to_cam = rigid(r_rect.T, np.zeros(3)) @ rect_from_ego
    fields = {f"P{int(number)}": p_rect for number, p_rect in P_RECT.items()}
    fields |= {"R0_rect": r_rect, "Tr_velo_to_cam": velo_to_cam[:3]}
    fields["Tr_imu_to_velo"] = rigid(IMU_TO_VELO_R, IMU_TO_VELO_T)[:3]
    return "".join(f"{key}: {numbers(values)}\n" for key, values in fields.items())


def picture(path: Path, center_m: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(draw(center_m)).save(path)


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def _truth(root: Path, folder: Path, segment: str, numbers_: Sequence[int]) -> TinySequence:
    seconds = STEP_S * np.array(numbers_)
    poses = ego_poses(seconds)
    poses[:, :3, 3] -= poses[0, :3, 3]
    center_m = np.tile(CAR_START_M, (len(seconds), 1))
    center_m[:, 0] += (CAR_SPEED_MPS - EGO_SPEED_MPS) * seconds
    car = np.column_stack([center_m, np.tile(CAR_LWH_M, (len(seconds), 1)), np.zeros(len(seconds))])
    clouds = [street_points(second)[0] for second in seconds]
    return TinySequence(root, folder, segment, list(numbers_), poses, clouds, car)


def _write_sweep(
    path: Path, truth: TinySequence, step: int, *, is_twisted: bool = False, full: int = 1
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    xyz, intensity = street_points(STEP_S * truth.numbers[step])
    seen = twisted(xyz, STEP_S) if is_twisted else xyz
    np.column_stack([seen, intensity * full]).astype("<f4").tofile(path)
