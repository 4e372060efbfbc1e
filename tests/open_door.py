"""A tiny drive as the tables of the open door: a ground, a wall, one car; all known."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

SEGMENT = "town-1"
FRAMES = (3, 4, 6, 7)  # gaps are allowed
START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
SPEED_MPS = 5.0
GROUND_Z_M = -1.9
WIDTH_PX, HEIGHT_PX = 120, 60
FOCAL_PX = 60.0
RED = (200, 30, 30)


def pose(step: int) -> np.ndarray:
    """(4, 4) world_from_ego of the step-th frame: along x, turning slowly."""
    yaw = 0.02 * FRAMES[step]
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:3, 3] = (4.0e5 + SPEED_MPS * STEP_NS / 1e9 * FRAMES[step], 5.6e6, 30.0)
    return matrix


def world_points() -> np.ndarray:
    """(n, 3) a ground, a wall and a box, around the path."""
    rng = np.random.default_rng(0)
    ground = np.column_stack(
        [rng.uniform(-25, 30, (900, 1)), rng.uniform(-15, 15, (900, 1)), np.zeros((900, 1))]
    )
    wall = np.column_stack([rng.uniform(-20, 30, 300), np.full(300, 9.0), rng.uniform(0, 4, 300)])
    car = np.column_stack([rng.uniform(10, 14, 80), np.full(80, 3.0), rng.uniform(0.2, 1.5, 80)])
    return np.vstack([ground, wall, car])


def ego_points(step: int) -> np.ndarray:
    """(n, 3) the world as seen from the step-th frame."""
    start = pose(0)
    world = world_points() @ start[:3, :3].T + start[:3, 3]
    here = pose(step)
    xyz = (world - here[:3, 3]) @ here[:3, :3]
    return (xyz + [0, 0, GROUND_Z_M]).astype(np.float32)


def png(
    color: tuple[int, int, int] = RED, size: tuple[int, int] = (WIDTH_PX, HEIGHT_PX), kind: str = "PNG"
) -> bytes:
    """Bytes of a picture of one color."""
    buffer = io.BytesIO()
    Image.new("RGB", size, color).save(buffer, kind)
    return buffer.getvalue()


def point_columns(**changes: Any) -> dict[str, Any]:
    """Columns of the points table; a change replaces a column, None leaves it out."""
    clouds = [ego_points(step) for step in range(len(FRAMES))]
    columns: dict[str, Any] = {
        "frame": pa.array(FRAMES, pa.int32()),
        "time_ns": pa.array([START_NS + STEP_NS * frame for frame in FRAMES], pa.int64()),
        "world_from_ego": pa.array(
            [pose(step).ravel() for step in range(len(FRAMES))], pa.list_(pa.float64(), 16)
        ),
        "x_m": [cloud[:, 0] for cloud in clouds],
        "y_m": [cloud[:, 1] for cloud in clouds],
        "z_m": [cloud[:, 2] for cloud in clouds],
        "intensity": [np.full(len(cloud), 0.25, np.float32) for cloud in clouds],
        "sensor": pa.array([np.full(len(cloud), 2, np.uint8) for cloud in clouds], pa.list_(pa.uint8())),
        "remark": ["ignored"] * len(FRAMES),
    }
    columns.update(changes)
    return {name: values for name, values in columns.items() if values is not None}


def camera_columns(**changes: Any) -> dict[str, Any]:
    """Columns of the cameras table: one camera that looks along x."""
    mount = np.eye(4)
    mount[:3, :3] = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], dtype=float).T
    mount[:3, 3] = (0.5, 0.0, -0.2)
    columns: dict[str, Any] = {
        "camera": ["front"],
        "width_px": pa.array([WIDTH_PX], pa.int32()),
        "height_px": pa.array([HEIGHT_PX], pa.int32()),
        "fx_px": [FOCAL_PX],
        "fy_px": [FOCAL_PX],
        "cx_px": [(WIDTH_PX - 1) / 2],
        "cy_px": [(HEIGHT_PX - 1) / 2],
        "distortion_model": ["none"],
        "distortion": pa.array([[]], pa.list_(pa.float64())),
        "ego_from_camera": pa.array([mount.ravel()], pa.list_(pa.float64(), 16)),
    }
    columns.update(changes)
    return {name: values for name, values in columns.items() if values is not None}


def image_columns(**changes: Any) -> dict[str, Any]:
    """Columns of the images table: bytes of a picture for each frame, 2 ms after the sweep."""
    columns: dict[str, Any] = {
        "frame": pa.array(FRAMES, pa.int32()),
        "camera": ["front"] * len(FRAMES),
        "time_ns": pa.array([START_NS + STEP_NS * frame + 2_000_000 for frame in FRAMES], pa.int64()),
        "data": pa.array([png(kind="PNG" if frame % 2 else "JPEG") for frame in FRAMES], pa.binary()),
    }
    columns.update(changes)
    return {name: values for name, values in columns.items() if values is not None}


def label_columns(**changes: Any) -> dict[str, Any]:
    """Columns of the labels table: the car, which stands, in each frame."""
    boxes = []
    for step in range(len(FRAMES)):
        start, here = pose(0), pose(step)
        center = start[:3, :3] @ [12.0, 3.0, 0.8] + start[:3, 3]
        boxes.append((center - here[:3, 3]) @ here[:3, :3] + [0, 0, GROUND_Z_M])
    x, y, z = np.array(boxes).T
    count = len(FRAMES)
    columns: dict[str, Any] = {
        "frame": pa.array(FRAMES, pa.int32()),
        "track_id": ["car-1"] * count,
        "class": ["Car"] * count,
        "center_x_m": x,
        "center_y_m": y,
        "center_z_m": z,
        "length_m": [4.4] * count,
        "width_m": [1.8] * count,
        "height_m": [1.6] * count,
        "heading_rad": [0.0] * count,
    }
    columns.update(changes)
    return {name: values for name, values in columns.items() if values is not None}


def write_table(
    path: Path, columns: dict[str, Any], metadata: dict[str, str] | None = None, **options: Any
) -> None:
    """Write a table, by default with a row group a row."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.table(columns)
    if metadata is not None:
        table = table.replace_schema_metadata(metadata)
    pq.write_table(table, path, **{"row_group_size": 1, **options})


def write_open_door(root: Path, segment: str = SEGMENT) -> Path:
    """Write a drive with all four tables and return the root."""
    write_table(root / f"points/{segment}.parquet", point_columns())
    write_table(root / f"cameras/{segment}.parquet", camera_columns())
    write_table(root / f"images/{segment}.parquet", image_columns())
    write_table(root / f"labels/{segment}.parquet", label_columns())
    return root
