"""A small recording whose truth is known: walls around a road, seen while driving at a known speed along a curve."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets.shared.point_writers import pcd

FIRST_NS = 1_532_402_927_647_951_000
STEP_NS = 100_000_000
WIDTH_PX, HEIGHT_PX = 64, 48
INTRINSIC = np.array([[40.0, 0, 31.5], [0, 40.0, 23.5], [0, 0, 1]])


def times_ns(frames: int) -> list[int]:
    return [FIRST_NS + STEP_NS * k for k in range(frames)]


def world_from_lidar(frame: float) -> np.ndarray:
    """(4, 4) pose at a frame, which need not be whole: 1 m and 2 degrees a frame."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", 2 * frame, degrees=True).as_matrix()
    pose[:3, 3] = [frame, 0.1 * frame, 0]
    return pose


def rows(frame: int, total: int = 400) -> np.ndarray:
    """(n, 4) x, y, z, intensity 0 to 255 in the axes of the LiDAR."""
    angle_rad = 2 * np.pi * np.arange(total) / total
    reach_m = 12 + 3 * np.sin(2 * angle_rad + 0.3 * frame)
    z_m = np.where(np.arange(total) % 2, -1.7, 0.5)
    intensity = np.arange(total) % 256
    return np.column_stack([reach_m * np.cos(angle_rad), reach_m * np.sin(angle_rad), z_m, intensity])


def write_scans(folder: Path, frames: int = 4, *, names: str = "number") -> Path:
    """A folder of binary PCD files called by number from 60 on, or by time."""
    folder.mkdir(parents=True)
    for k, time_ns in enumerate(times_ns(frames)):
        stem = f"{60 + k:06d}" if names == "number" else f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        (folder / f"{stem}.pcd").write_bytes(pcd(rows(k), "binary"))
    return folder


def quat_xyzw(pose: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(pose[:3, :3]).as_quat()


def write_tum(path: Path, at: list[float]) -> Path:
    """A TUM file with the poses at these frames."""
    lines = ["# time x y z qx qy qz qw"]
    for frame in at:
        time_ns, pose = FIRST_NS + round(frame * STEP_NS), world_from_lidar(frame)
        numbers = " ".join(f"{value:.12f}" for value in (*pose[:3, 3], *quat_xyzw(pose)))
        lines.append(f"{time_ns // 10**9}.{time_ns % 10**9:09d} {numbers}")
    path.write_text("\n".join(lines) + "\n")
    return path


def picture(shade: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((HEIGHT_PX, WIDTH_PX, 3), shade, np.uint8)).save(file, "PNG")
    return file.getvalue()
