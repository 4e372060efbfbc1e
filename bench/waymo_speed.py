"""How fast a real-size Waymo segment is read: python bench/waymo_speed.py [--frames 200] [--folder FOLDER] [--v1].

Makes a segment with the sizes of real ones (lasers of 64 x 2650 and four times 200 x 600 pixels, 180 000 points,
five cameras, one row group a file) by repeating a few made-up frames, and reads it in a fresh process: one frame
of the middle at first, then all frames with their pixels and pictures. Exits 1 where a bar is missed.
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when numpy is imported

import argparse
import io
import multiprocessing
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.types import Array

SEGMENT = "10000000000000000001_0_000_20_000"
SHAPES = {1: (64, 2650), 2: (200, 600), 3: (200, 600), 4: (200, 600), 5: (200, 600)}
SHARE = {1: 0.85, 2: 0.05, 3: 0.05, 4: 0.05, 5: 0.05}  # of the pixels with a return: 170 000 points
SECOND = 0.07  # of the returns: 12 000 points
SIZES = {1: (192, 128), 2: (192, 128), 3: (192, 128), 4: (192, 88), 5: (192, 88)}
START_US, STEP_US = 1_553_735_853_462_203, 100_000
DISTINCT = 3
FPS, FRAME_S, MEMORY_MIB = 10.0, 0.3, 1024


def main() -> None:
    """Print the figures; exits 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--folder", type=Path, help="where the segment is kept for the next run")
    parser.add_argument("--codec", default="none", help="compression of the files")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        if not (folder / "vehicle_pose").is_dir():
            write_segment(folder, options.frames, options.codec)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            missed = pool.apply(read_segment, (folder,))
    sys.exit(missed)


def read_segment(folder: Path) -> bool:
    """Return whether a bar is missed."""
    start = time.perf_counter()
    drive = Waymo(folder).open(SEGMENT)
    opened_s = time.perf_counter() - start
    total = len(drive.points(len(drive.frames) * 3 // 4))
    frame_s = time.perf_counter() - start
    print(f"opened in {opened_s:.2f} s; a frame of {total} points after {frame_s:.2f} s (bar {FRAME_S} s)")
    drive = Waymo(folder).open(SEGMENT)
    start, start_cpu = time.perf_counter(), time.process_time()
    for frame in drive.frames:
        drive.points(frame.index)
        for camera in drive.cameras:
            drive.pixels(frame.index, camera.name)
            drive.image(frame.index, camera.name)
    wall_s, cpu_s = time.perf_counter() - start, time.process_time() - start_cpu
    fps = len(drive.frames) / cpu_s
    memory_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(drive.frames)} frames with pixels and pictures: {fps:.1f} frames/s a core (bar {FPS}), "
        f"{len(drive.frames) / wall_s:.1f} by the clock; {memory_mib:.0f} MiB at most (bar {MEMORY_MIB})"
    )
    return fps < FPS or frame_s > FRAME_S or memory_mib > MEMORY_MIB


def write_segment(folder: Path, frames: int, codec: str) -> None:
    """Write the components that a drive reads, rows in any order."""
    rng = np.random.default_rng(0)
    order = [(frame, laser) for frame in range(frames) for laser in rng.permutation(list(SHAPES)).tolist()]
    made = {laser: [range_images(rng, laser) for _ in range(DISTINCT)] for laser in SHAPES}
    keys = {"time": [frame for frame, _ in order], "key.laser_name": [laser for _, laser in order]}
    for component, name, returns in (
        ("lidar", "LiDARComponent", (1, 2)),
        ("lidar_camera_projection", "LiDARCameraProjectionComponent", (1, 2)),
        ("lidar_pose", "LiDARPoseComponent", (1,)),
    ):
        rows = [row for row, (_, laser) in enumerate(order) if component != "lidar_pose" or laser == 1]
        columns = {}
        for number in returns:
            cells = [made[order[row][1]][order[row][0] % DISTINCT][component][number - 1] for row in rows]
            prefix = f"[{name}].range_image_return{number}"
            columns[f"{prefix}.values"] = pa.chunked_array([list_array(cell) for cell in cells])
            columns[f"{prefix}.shape"] = pa.array(
                [list(cell.shape) for cell in cells], pa.list_(pa.int32(), 3)
            )
        write(folder, component, {key: [keys[key][row] for row in rows] for key in keys}, columns, codec)
    write_small(folder, frames, codec)


def list_array(cell: Array) -> pa.Array:
    """Return one row of a column of lists, without a copy."""
    return pa.ListArray.from_arrays(pa.array([0, cell.size], pa.int32()), pa.array(cell.ravel()))


def range_images(rng: np.random.Generator, laser: int) -> dict[str, list[Array]]:
    """Return range images, camera projections and pixel poses of one laser, by return."""
    height, width = SHAPES[laser]
    has_return = np.repeat(rng.random((height, width // 10 + 1)) < SHARE[laser], 10, axis=1)[:, :width]
    has_second = has_return & (rng.random((height, width)) < SECOND)
    column = np.arange(width)
    found: dict[str, list[Array]] = {"lidar": [], "lidar_camera_projection": []}
    for mask in (has_return, has_second):
        image = np.full((height, width, 4), -1, np.float32)
        image[mask, :3] = rng.uniform([3, 0, 0], [60, 1.5, 1.5], (int(mask.sum()), 3))
        projection = np.zeros((height, width, 6), np.float32)
        seen = mask & (column % 530 < 480)  # the cameras leave gaps
        projection[..., 0], projection[..., 1] = column * 5 // width + 1, column % 192
        projection[..., 2] = np.arange(height)[:, None] * 88 // height
        projection[~seen] = 0
        found["lidar"].append(image)
        found["lidar_camera_projection"].append(projection)
    poses = np.zeros((height, width, 6), np.float32)
    poses[..., 2] = 0.76 + 1e-5 * column
    poses[..., 3:] = rng.normal([-25211, 42391, -160], 0.002, (height, width, 3))
    found["lidar_pose"] = [poses]
    return found


def write_small(folder: Path, frames: int, codec: str) -> None:
    """Write poses, calibrations and pictures."""
    turn = np.array([[np.cos(0.76), -np.sin(0.76)], [np.sin(0.76), np.cos(0.76)]])
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = turn, (-25211, 42391, -160)
    matrix = pa.list_(pa.float64(), 16)
    name = "[VehiclePoseComponent].world_from_vehicle.transform"
    columns = {name: pa.array([pose.ravel()] * frames, matrix)}
    write(folder, "vehicle_pose", {"time": list(range(frames))[::-1]}, columns, codec)
    prefix, lasers = "[LiDARCalibrationComponent].", sorted(SHAPES)
    beams = np.linspace(-0.3, 0.04, SHAPES[1][0])
    columns = {
        f"{prefix}extrinsic.transform": pa.array([np.eye(4).ravel()] * len(lasers), matrix),
        f"{prefix}beam_inclination.min": pa.array([-np.pi / 2] * len(lasers)),
        f"{prefix}beam_inclination.max": pa.array([np.pi / 6] * len(lasers)),
        f"{prefix}beam_inclination.values": pa.array([beams, None, None, None, None]),
    }
    write(folder, "lidar_calibration", {"key.laser_name": lasers}, columns, codec)
    prefix, cameras = "[CameraCalibrationComponent].", sorted(SIZES)
    intrinsic = dict(f_u=205, f_v=205, c_u=96, c_v=64, k1=0.04, k2=-0.3, p1=0, p2=0, k3=0)
    columns = {
        f"{prefix}intrinsic.{key}": pa.array([float(value)] * len(cameras))
        for key, value in intrinsic.items()
    }
    columns[f"{prefix}extrinsic.transform"] = pa.array([np.eye(4).ravel()] * len(cameras), matrix)
    columns[f"{prefix}width"] = pa.array([SIZES[camera][0] for camera in cameras], pa.int32())
    columns[f"{prefix}height"] = pa.array([SIZES[camera][1] for camera in cameras], pa.int32())
    write(folder, "camera_calibration", {"key.camera_name": cameras}, columns, codec)
    pairs = [(frame, camera) for frame in range(frames) for camera in cameras]
    content = {camera: jpeg(*SIZES[camera]) for camera in cameras}
    columns = {
        "[CameraImageComponent].image": pa.array([content[camera] for _, camera in pairs]),
        "[CameraImageComponent].pose_timestamp": pa.array(
            [(START_US + frame * STEP_US) / 1e6 + 0.05 for frame, _ in pairs]
        ),
    }
    keys = {"time": [frame for frame, _ in pairs], "key.camera_name": [camera for _, camera in pairs]}
    write(folder, "camera_image", keys, columns, codec)


def jpeg(width_px: int, height_px: int) -> bytes:
    """Return a picture of noise: no real one is harder to read."""
    rgb = np.random.default_rng(0).integers(0, 255, (height_px, width_px, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "JPEG", quality=85)
    return file.getvalue()


def write(
    folder: Path, component: str, keys: dict[str, list[int]], columns: dict[str, pa.Array], codec: str
) -> None:
    """Write a component as one row group."""
    rows = len(next(iter(keys.values())))
    table = {"key.segment_context_name": pa.array([SEGMENT] * rows)}
    for key, values in keys.items():
        if key == "time":
            stamps = [START_US + frame * STEP_US for frame in values]
            table["key.frame_timestamp_micros"] = pa.array(stamps, pa.int64())
        else:
            table[key] = pa.array(values, pa.int8())
    (folder / component).mkdir(parents=True, exist_ok=True)
    pq.write_table(
        pa.table({**table, **columns}),
        folder / component / f"{SEGMENT}.parquet",
        compression=codec,
        row_group_size=rows,
    )


if __name__ == "__main__":
    main()
