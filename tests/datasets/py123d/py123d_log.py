"""A tiny log of py123d, written by the library itself: a ground, a wall, one car that drives; all known."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from py123d.api.scene.arrow.arrow_log_writer import ArrowLogWriter, SyncConfig
from py123d.api.scene.arrow.utils.log_writer_config import LogWriterConfig
from py123d.datatypes import (
    BoxDetectionAttributes,
    BoxDetectionSE3,
    BoxDetectionsSE3,
    BoxDetectionsSE3Metadata,
    CameraID,
    EgoStateSE3,
    EgoStateSE3Metadata,
    Lidar,
    LidarID,
    LidarMergedMetadata,
    LidarMetadata,
    LogMetadata,
    PinholeCameraMetadata,
    PinholeDistortion,
    PinholeIntrinsics,
    Timestamp,
)
from py123d.geometry import BoundingBoxSE3, PoseSE3, Vector3D
from py123d.parser.base_dataset_parser import ModalitiesSync, ParsedCamera
from py123d.parser.registry import AV2SensorBoxDetectionLabel

from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.datasets.py123d.drive import Py123dDrive

SPLIT, LOG = "tiny_val", "2026.01.02-drive_0001"
LOG_FOLDER = f"logs/{SPLIT}/{LOG}"
COUNT = 4
START_US, STEP_US = 1_700_000_000_000_000, 100_000
SPEED_MPS, CAR_SPEED_MPS = 5.0, 8.0
GROUND_Z_M = -0.5
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 120, 60, 60.0
RED = (200, 30, 30)
CAR_SIZE_LWH_M = (4.0, 1.8, 1.5)
OUTLINE_LWH_M = (4.8, 2.0, 1.6)
CENTER_X_M = 1.4  # of the car before its IMU

EGO = EgoStateSE3Metadata(
    "tiny",
    width=OUTLINE_LWH_M[1],
    length=OUTLINE_LWH_M[0],
    height=OUTLINE_LWH_M[2],
    wheel_base=2.8,
    center_to_imu_se3=PoseSE3(CENTER_X_M, 0, 0.3, 1, 0, 0, 0),
    rear_axle_to_imu_se3=PoseSE3.identity(),
)
TOP = LidarMetadata("top", LidarID.LIDAR_TOP)
DOWN = LidarMetadata("down", LidarID.LIDAR_DOWN)
MERGED = LidarMergedMetadata({LidarID.LIDAR_TOP: TOP, LidarID.LIDAR_DOWN: DOWN})
BOXES = BoxDetectionsSE3Metadata(AV2SensorBoxDetectionLabel)
# The camera looks forward: its x is the car's right, its y down, its z forward.
FRONT_MOUNT = PoseSE3(1.0, 0.0, 1.5, 0.5, -0.5, 0.5, -0.5)
FRONT = PinholeCameraMetadata(
    "ring_front_center",
    CameraID.PCAM_F0,
    PinholeIntrinsics(FOCAL_PX, FOCAL_PX, 59.5, 29.5),
    PinholeDistortion(0.01, 0.0, 0.0, 0.0, 0.0),
    WIDTH_PX,
    HEIGHT_PX,
    FRONT_MOUNT,
)


def yaw_pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> PoseSE3:
    """A pose that is turned about z."""
    return PoseSE3(x_m, y_m, z_m, np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2))


def pose(step: float) -> PoseSE3:
    """World pose of the IMU at a step: along x, turning slowly."""
    return yaw_pose(4.0e5 + SPEED_MPS * STEP_US / 1e6 * step, 5.6e6, 30.0, 0.02 * step)


def time_us(step: int) -> int:
    return START_US + STEP_US * step


def ego_points() -> np.ndarray:
    """(n, 3) a ground around the car and a wall: the same in each sweep."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-20, 25, 900), rng.uniform(-12, 12, 900), np.full(900, GROUND_Z_M)])
    ground = ground[np.abs(ground[:, 1]) > 1.5]
    wall = np.column_stack([rng.uniform(-20, 30, 300), np.full(300, 9.0), rng.uniform(0, 4, 300)])
    return np.vstack([ground, wall]).astype(np.float32)


def sweep(step: int, metadata: Any = MERGED, xyz: np.ndarray | None = None, **features: Any) -> Lidar:
    """The sweep of a step; a feature that is None is left out."""
    xyz = ego_points() if xyz is None else xyz
    found: dict[str, Any] = {
        "intensity": np.full(len(xyz), 51, np.uint8),
        "ids": np.where(np.arange(len(xyz)) % 2, 2, 7).astype(np.uint8),
        "timestamps": np.linspace(time_us(step), time_us(step) + 90_000, len(xyz)).astype(np.int64),
    }
    found |= features
    start = Timestamp.from_us(time_us(step))
    end = Timestamp.from_us(time_us(step) + STEP_US)
    return Lidar(start, end, metadata, xyz, {key: value for key, value in found.items() if value is not None})


def ego_state(step: int) -> EgoStateSE3:
    return EgoStateSE3.from_imu(pose(step), EGO, Timestamp.from_us(time_us(step)))


def car(step: int) -> PoseSE3:
    """World pose of the car that drives ahead."""
    return yaw_pose(4.0e5 + 12.0 + CAR_SPEED_MPS * STEP_US / 1e6 * step, 5.6e6 + 3.0, 30.0 + 0.2, 0.3)


def box(pose_se3: PoseSE3, track: str = "car-1", label: Any = None, **options: Any) -> BoxDetectionSE3:
    label = AV2SensorBoxDetectionLabel.REGULAR_VEHICLE if label is None else label
    shape = BoundingBoxSE3(pose_se3, *CAR_SIZE_LWH_M)
    return BoxDetectionSE3(
        BoxDetectionAttributes(label, track, options.get("num_lidar_points", 7)),
        shape,
        options.get("velocity"),
    )


def boxes(step: int, found: Sequence[BoxDetectionSE3] | None = None) -> BoxDetectionsSE3:
    if found is None:
        found = [box(car(step), velocity=Vector3D(CAR_SPEED_MPS, 0.0, 0.0))]
    return BoxDetectionsSE3(list(found), Timestamp.from_us(time_us(step)), BOXES)


def picture(size: tuple[int, int] = (WIDTH_PX, HEIGHT_PX), color: tuple[int, int, int] = RED) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", size, color).save(buffer, "JPEG")
    return buffer.getvalue()


def photo(step: int, metadata: Any = FRONT, content: bytes | None = None) -> ParsedCamera:
    return ParsedCamera(
        metadata,
        Timestamp.from_us(time_us(step) + 20_000),
        None,
        byte_string=picture() if content is None else content,
    )


def write_log(
    root: Path,
    steps: Sequence[Sequence[Any]] | None = None,
    *,
    log: str = LOG,
    split: str = SPLIT,
    sync: SyncConfig | None = None,
    times_us: Sequence[int] | None = None,
    codec: str = "ipc_lz4",
    pictures: str = "jpeg_binary",
) -> Path:
    """Write a log by the library's own writer.

    Args:
        root: The folder of py123d data.
        steps: The modalities of each iteration; those of the tiny drive where it is None.
        log: Its name.
        split: Its split.
        sync: Write at the rate of each modality, and find iterations afterwards.
        times_us: Times of the iterations.
        codec: How sweeps are stored.
        pictures: How pictures are stored.
    """
    if steps is None:
        steps = [[ego_state(step), sweep(step), photo(step), boxes(step)] for step in range(COUNT)]
    config = LogWriterConfig(
        camera_store_option=pictures, lidar_store_option="binary", lidar_codec=codec, write_route=False
    )
    writer = ArrowLogWriter(config, root / "logs", root / "sensors", sync_config=sync)
    assert writer.reset(LogMetadata("tiny", split, log, "nowhere"))
    for step, modalities in enumerate(steps):
        if sync is not None:
            for modality in modalities:
                writer.write_async(modality)
        else:
            at_us = time_us(step) if times_us is None else times_us[step]
            writer.write_sync(ModalitiesSync(Timestamp.from_us(at_us), list(modalities)))
    writer.close()
    return root


def drive_of(root: Path) -> Py123dDrive:
    return Py123dLogs(root).open(LOG)


def drive_with(root: Path, *modalities: Any, **options: Any) -> Py123dDrive:
    """A log of two iterations: each modality is given by a function of its step, or left out where it is None."""
    steps = [[found for make in modalities if (found := make(step)) is not None] for step in range(2)]
    return drive_of(write_log(root, steps, **options))
