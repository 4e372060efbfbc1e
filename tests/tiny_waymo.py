"""A tiny Waymo segment with known truth, as v2 (Parquet) and as v1 (TFRecord)."""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from upvl_cli.datasets.waymo.records import masked_crc32c
from upvl_cli.types import Array

SEGMENT = "10000000000000000001_0_000_20_000"
START_US, STEP_US = 1_553_735_853_462_203, 100_000
TOP, FRONT, REAR = 1, 2, 5
SHAPES = {TOP: (6, 24), FRONT: (4, 10), REAR: (4, 10)}
CAMERAS = {1: (32, 20), 4: (32, 14)}  # width and height in pixels
PICTURE_DELAY_S = 0.05
INTRINSIC = [40.0, 41.0, 16.5, 10.5, 0.01, -0.02, 0.001, 0.002, 0.003]
TRANSFORM = pa.list_(pa.float64(), 16)
SHAPE = pa.list_(pa.int32(), 3)


def turn(roll: float, pitch: float, yaw: float) -> Array:
    """Rz Ry Rx, as (3, 3)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def pose(rotation: Array, translation: Any) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


MOUNTS = {
    TOP: pose(turn(0.006, -0.002, 2.58), [1.43, 0, 2.184]),
    FRONT: pose(turn(0.004, 0.022, -0.005), [4.07, 0, 0.689]),
    REAR: pose(turn(0.008, 0.027, 3.113), [-1.155, 0, 0.464]),
}
BEAMS = {TOP: np.array([-0.3, -0.2, -0.12, -0.06, 0.0, 0.04]), FRONT: None, REAR: None}
EDGES = (-1.5, 0.5)
CAMERA_MOUNTS = {1: pose(turn(0, 0.01, 0), [1.5, 0, 2.1]), 4: pose(turn(0, 0, 1.56), [1.4, 0.1, 2.1])}


def car_at(seconds: float) -> Array:
    """Pose of the car: it drives a bend at 8 m/s, far from the origin of the world."""
    yaw = 0.76 + 0.12 * seconds
    place = [-25211.2 + 8 * seconds * np.cos(yaw), 42391.1 + 8 * seconds * np.sin(yaw), -160.6]
    return pose(turn(0.004, 0.003, yaw), place)


@dataclass
class TinyFrame:
    """One frame; range images by (laser, return)."""

    stamp: int
    pose: Array
    range_images: dict[tuple[int, int], Array]
    projections: dict[tuple[int, int], Array]
    pixel_poses: Array
    pictures: dict[int, bytes]
    boxes: list[dict[str, Any]]
    xyz_ego_m: dict[tuple[int, int], Array] = field(default_factory=dict)


def tiny_segment(frames: int = 3, seed: int = 0) -> list[TinyFrame]:
    """Return frames with random ranges, and where their points are, by explicit matrices for each pixel."""
    rng = np.random.default_rng(seed)
    return [_tiny_frame(rng, number) for number in range(frames)]


def _tiny_frame(rng: np.random.Generator, number: int) -> TinyFrame:
    seconds, (height, width) = number * STEP_US / 1e6, SHAPES[TOP]
    pixel_poses = np.zeros((height, width, 6), np.float32)
    for column in range(width):
        car = car_at(seconds + 0.1 * column / width)
        yaw = np.arctan2(car[1, 0], car[0, 0])
        pixel_poses[:, column] = [0.004, 0.003, yaw, *car[:3, 3]]
    frame = TinyFrame(
        stamp=START_US + number * STEP_US,
        pose=car_at(seconds + 0.05),
        range_images={},
        projections={},
        pixel_poses=pixel_poses,
        pictures={camera: picture(*size, 40 * camera) for camera, size in CAMERAS.items()},
        boxes=tiny_boxes(number),
    )
    for laser, shape in SHAPES.items():
        for number_of_return, share in ((1, 0.7), (2, 0.2)):
            image = np.full((*shape, 4), -1, np.float32)
            seen = rng.random(shape) < share
            count = int(seen.sum())
            image[seen, 0] = rng.uniform(2, 60, count)
            image[seen, 1], image[seen, 2] = rng.uniform(0, 3, count), rng.uniform(0, 1.5, count)
            image[seen, 3] = np.where(rng.random(count) < 0.2, 1, -1)
            projection = np.zeros((*shape, 6), np.float32)
            projection[seen, :3] = np.stack(
                [np.ones(count), rng.integers(0, 32, count), rng.integers(0, 20, count)], 1
            )
            both = seen & (rng.random(shape) < 0.3)
            projection[both, 3:] = [4, 7, 3]
            projection[seen & (rng.random(shape) < 0.2)] = 0
            key = (laser, number_of_return)
            frame.range_images[key], frame.projections[key] = image, projection
            frame.xyz_ego_m[key] = true_places(frame, laser, image)
    return frame


def true_places(frame: TinyFrame, laser: int, image: Array) -> Array:
    """Return (n, 3) places of the returns, one after the other by 4 x 4 matrices."""
    height, width = image.shape[:2]
    mount, beams = MOUNTS[laser], BEAMS[laser]
    found = []
    for row in range(height):
        share = (height - 1 - row + 0.5) / height  # row 0 is the highest beam
        inclination = EDGES[0] + share * (EDGES[1] - EDGES[0]) if beams is None else beams[height - 1 - row]
        for column in range(width):
            distance = float(image[row, column, 0])
            if not distance > 0:
                continue
            azimuth = np.pi - 2 * np.pi * (column + 0.5) / width - np.arctan2(mount[1, 0], mount[0, 0])
            place = distance * np.array(
                [
                    np.cos(azimuth) * np.cos(inclination),
                    np.sin(azimuth) * np.cos(inclination),
                    np.sin(inclination),
                ]
            )
            place = mount @ [*place, 1]
            if laser == TOP:
                roll, pitch, yaw, *where = frame.pixel_poses[row, column].astype(float)
                place = np.linalg.inv(frame.pose) @ pose(turn(roll, pitch, yaw), where) @ place
            found.append(place[:3])
    return np.array(found).reshape(-1, 3)


def tiny_boxes(number: int) -> list[dict[str, Any]]:
    """Return two objects: a car with everything, and a sign that is missing in frame 1, without what is optional."""
    car = dict(
        id="car",
        box=[12 + number, 3, 0.8, 4.5, 2, 1.6, 0.3],
        type=1,
        count=40,
        speed=[3.0, 4.0, 0.0],
        level=2,
    )
    sign = dict(id="sign", box=[9, -4, 2.5, 0.1, 0.6, 0.6, -1.5], type=3, count=2, speed=None, level=None)
    return [car, sign] if number != 1 else [car]


def picture(width_px: int, height_px: int, level: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((height_px, width_px, 3), level, np.uint8)).save(file, "JPEG")
    return file.getvalue()


# ---- v2


def write_v2(
    root: Path,
    frames: list[TinyFrame],
    *,
    rows_per_group: int = 1000,
    codec: str = "snappy",
    without: tuple[str, ...] = (),
) -> Path:
    """Write the components, their rows in an order of their own, with a column that no schema knows."""
    for component, columns in v2_columns(frames).items():
        if component not in without:
            write_component(root, component, columns, rows_per_group=rows_per_group, codec=codec)
    return root


def write_component(
    root: Path, component: str, columns: dict[str, Any], *, rows_per_group: int = 1000, codec: str = "snappy"
) -> None:
    """Write one component, shuffled."""
    table = pa.table({"index": [str(row) for row in range(len(next(iter(columns.values()))))], **columns})
    order = np.random.default_rng(len(component)).permutation(len(table))
    path = root / component / f"{SEGMENT}.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(
        table.take(order), path, row_group_size=rows_per_group, compression=codec, data_page_size=512
    )


def v2_columns(frames: list[TinyFrame]) -> dict[str, dict[str, Any]]:
    """Return the columns of each component."""
    stamps = [frame.stamp for frame in frames]
    found = {
        "vehicle_pose": {
            **_keys(stamps),
            "[VehiclePoseComponent].world_from_vehicle.transform": pa.array(
                [frame.pose.ravel() for frame in frames], TRANSFORM
            ),
        }
    }
    found["lidar"] = _images(frames, "LiDARComponent", [f.range_images for f in frames], (1, 2))
    found["lidar_camera_projection"] = _images(
        frames, "LiDARCameraProjectionComponent", [f.projections for f in frames], (1, 2)
    )
    found["lidar_pose"] = _images(
        frames, "LiDARPoseComponent", [{(TOP, 1): f.pixel_poses} for f in frames], (1,)
    )
    lasers, prefix = list(SHAPES), "[LiDARCalibrationComponent]."
    found["lidar_calibration"] = {
        "key.segment_context_name": [SEGMENT] * len(lasers),
        "key.laser_name": pa.array(lasers, pa.int8()),
        f"{prefix}extrinsic.transform": pa.array([MOUNTS[laser].ravel() for laser in lasers], TRANSFORM),
        f"{prefix}beam_inclination.min": [EDGES[0]] * len(lasers),
        f"{prefix}beam_inclination.max": [EDGES[1]] * len(lasers),
        f"{prefix}beam_inclination.values": pa.array(
            [BEAMS[laser] for laser in lasers], pa.list_(pa.float64())
        ),
    }
    found.update(_camera_columns(frames))
    found["lidar_box"] = _box_columns(frames)
    return found


def _keys(stamps: list[int]) -> dict[str, Any]:
    return {
        "key.segment_context_name": [SEGMENT] * len(stamps),
        "key.frame_timestamp_micros": pa.array(stamps, pa.int64()),
    }


def _images(
    frames: list[TinyFrame], name: str, images: list[dict[tuple[int, int], Array]], returns: tuple[int, ...]
) -> dict[str, Any]:
    rows = [
        (step, laser) for step in range(len(frames)) for laser in sorted({key[0] for key in images[step]})
    ]
    columns = _keys([frames[step].stamp for step, _ in rows])
    columns["key.laser_name"] = pa.array([laser for _, laser in rows], pa.int8())
    for number in returns:
        cells = [images[step].get((laser, number)) for step, laser in rows]
        prefix = f"[{name}].range_image_return{number}"
        columns[f"{prefix}.values"] = pa.array(
            [None if cell is None else cell.ravel() for cell in cells], pa.list_(pa.float32())
        )
        columns[f"{prefix}.shape"] = pa.array(
            [None if cell is None else list(cell.shape) for cell in cells], SHAPE
        )
    return columns


def _camera_columns(frames: list[TinyFrame]) -> dict[str, dict[str, Any]]:
    cameras, prefix = list(CAMERAS), "[CameraCalibrationComponent]."
    names = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
    calibration = {
        "key.segment_context_name": [SEGMENT] * len(cameras),
        "key.camera_name": pa.array(cameras, pa.int8()),
        **{
            f"{prefix}intrinsic.{name}": [value] * len(cameras)
            for name, value in zip(names, INTRINSIC, strict=True)
        },
        f"{prefix}extrinsic.transform": pa.array(
            [CAMERA_MOUNTS[camera].ravel() for camera in cameras], TRANSFORM
        ),
        f"{prefix}width": pa.array([CAMERAS[camera][0] for camera in cameras], pa.int32()),
        f"{prefix}height": pa.array([CAMERAS[camera][1] for camera in cameras], pa.int32()),
    }
    rows = [(frame, camera) for frame in frames for camera in frame.pictures]
    pictures = {
        **_keys([frame.stamp for frame, _ in rows]),
        "key.camera_name": pa.array([camera for _, camera in rows], pa.int8()),
        "[CameraImageComponent].image": pa.array(
            [frame.pictures[camera] for frame, camera in rows], pa.binary()
        ),
        "[CameraImageComponent].pose_timestamp": [frame.stamp / 1e6 + PICTURE_DELAY_S for frame, _ in rows],
    }
    return {"camera_calibration": calibration, "camera_image": pictures}


def _box_columns(frames: list[TinyFrame]) -> dict[str, Any]:
    rows = [(frame, box) for frame in frames for box in frame.boxes]
    prefix = "[LiDARBoxComponent]."
    columns = _keys([frame.stamp for frame, _ in rows])
    columns["key.laser_object_id"] = [box["id"] for _, box in rows]
    names = [f"box.{part}.{axis}" for part in ("center", "size") for axis in "xyz"]
    for place, name in enumerate([*names, "box.heading"]):
        columns[prefix + name] = pa.array([float(box["box"][place]) for _, box in rows])
    columns[f"{prefix}type"] = pa.array([box["type"] for _, box in rows], pa.int8())
    columns[f"{prefix}num_lidar_points_in_box"] = pa.array([box["count"] for _, box in rows], pa.int64())
    for place, axis in enumerate("xyz"):
        speeds = [None if box["speed"] is None else box["speed"][place] for _, box in rows]
        columns[f"{prefix}speed.{axis}"] = pa.array(speeds, pa.float64())
    columns[f"{prefix}difficulty_level.detection"] = pa.array([box["level"] for _, box in rows], pa.int8())
    return columns


# ---- v1


def write_v1(root: Path, frames: list[TinyFrame], *, zones: Any = (), empty: bool = False) -> Path:
    """Write one TFRecord, its records in reverse order; `empty` leaves the range images out."""
    root.mkdir(parents=True, exist_ok=True)
    path = root / f"segment-{SEGMENT}_with_camera_labels.tfrecord"
    path.write_bytes(b"".join(record(_frame(frame, zones, empty)) for frame in reversed(frames)))
    return path


def record(content: bytes) -> bytes:
    length = struct.pack("<Q", len(content))
    return (
        length
        + struct.pack("<I", masked_crc32c(length))
        + content
        + struct.pack("<I", masked_crc32c(content))
    )


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def block(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def whole(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def doubles(number: int, values: Any) -> bytes:
    return b"".join(varint(number << 3 | 1) + struct.pack("<d", value) for value in np.ravel(values).tolist())


def matrix(image: Array, *, is_float: bool) -> bytes:
    """A compressed MatrixFloat or MatrixInt32."""
    numbers = image.ravel()
    data = numbers.astype("<f4").tobytes() if is_float else b"".join(varint(int(value)) for value in numbers)
    return zlib.compress(block(1, data) + block(2, b"".join(whole(1, size) for size in image.shape)))


def _frame(frame: TinyFrame, zones: Any, empty: bool) -> bytes:
    context = block(1, SEGMENT.encode())
    for camera, (width_px, height_px) in CAMERAS.items():
        size = whole(4, width_px) + whole(5, height_px)
        mount = block(3, doubles(1, CAMERA_MOUNTS[camera]))
        context += block(2, whole(1, camera) + doubles(2, INTRINSIC) + mount + size)
    for laser, beams in BEAMS.items():
        angles = doubles(2, [] if beams is None else beams) + doubles(3, EDGES[0]) + doubles(4, EDGES[1])
        context += block(3, whole(1, laser) + angles + block(5, doubles(1, MOUNTS[laser])))
    out = block(1, context) + whole(2, frame.stamp) + block(3, doubles(1, frame.pose))
    for camera, content in frame.pictures.items():
        out += block(
            4, whole(1, camera) + block(2, content) + doubles(5, frame.stamp / 1e6 + PICTURE_DELAY_S)
        )
    for laser in SHAPES:
        message = whole(1, laser)
        for number, place in ((1, 2), (2, 3)):
            content = block(2, matrix(frame.range_images[laser, number], is_float=True))
            content += block(3, matrix(frame.projections[laser, number], is_float=False))
            if (laser, number) == (TOP, 1):
                content += block(4, matrix(frame.pixel_poses, is_float=True))
            message += block(place, content)
        out += block(5, b"" if empty else message)
    for box in frame.boxes:
        x, y, z, length, width, height, heading = box["box"]
        values = (x, y, z, width, length, height, heading)
        label = block(1, b"".join(doubles(place, value) for place, value in enumerate(values, start=1)))
        if box["speed"] is not None:
            speed = zip((1, 2, 5), box["speed"], strict=True)
            label += block(2, b"".join(doubles(place, value) for place, value in speed))
        label += whole(3, box["type"]) + block(4, box["id"].encode())
        label += (whole(5, box["level"]) if box["level"] else b"") + whole(7, box["count"])
        out += block(6, label)
    for corners in zones:
        out += block(7, doubles(1, corners[:, 0]) + doubles(2, corners[:, 1]))
    return out
