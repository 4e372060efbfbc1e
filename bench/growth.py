"""Time and peak memory of each stage against the length of a drive and the size of its sweeps.

    python bench/growth.py [--frames 250 1000 4000] [--points 2000 4000 8000] [--stages mask track] [--detector]

Makes drives in KITTI's raw layout: a street that repeats every 20 m, in which a car drives at 10 m/s behind another
one, past parked cars and oncoming traffic. The sweeps repeat too, so that a drive of any length is links to 20 files.
Runs each stage in a process of its own and prints its seconds and its peak (MiB, the process's own), the growth from
the first length to the last, and from the first size to the last. A stage that holds a window of seconds has the same
peak at any length that is longer than its window.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from workspaces import on_kitti

PERIOD = 20  # sweeps until the street looks the same again
STEP_M, FRAME_S = 1.0, 0.1
PICTURE_STEPS = 5  # a picture takes longer than all else
GROUND_Z_M = -1.73
REACH_M = 20  # a multiple of the period
LATITUDE_DEG, LONGITUDE_DEG, EARTH_RADIUS_M = 49.0, 8.43, 6378137.0
WIDTH_PX, HEIGHT_PX = 124, 37
CAR_LWH_M = np.array([4.2, 1.8, 1.5])
STAGES = (
    "odometry", "ground", "flow", "pca", "extract-vl", "mask", "boxes2d", "propose", "track", "amodal", "nms",
    "match-boxes2d", "classify",
    "labels", "pool-features",
)  # fmt: skip


def street(points: int) -> list[np.ndarray]:
    """Return the sweeps of one period, about that many points each, in ego axes: (n, 3)."""
    rng = np.random.default_rng(0)
    tiles = np.arange(-REACH_M, REACH_M, PERIOD)
    each = points // (10 * len(tiles))  # points of a tenth in one tile
    ground = np.column_stack([rng.uniform(0, PERIOD, 4 * each), rng.uniform(-9, 9, 4 * each)])
    tile = [np.column_stack([ground, np.zeros(4 * each)])]
    for y_m in (-9.0, 9.0):
        # A low wall: its points are close enough for one cluster.
        along, up = rng.uniform(0, PERIOD, 2 * each), rng.uniform(0.4, 1.0, 2 * each)
        tile.append(np.column_stack([along, np.full(2 * each, y_m), up]))
    tile.append(car(rng, each) + [8.0, 6.0, 0.0])
    still = np.concatenate([np.concatenate(tile) + [x_m, 0, 0] for x_m in tiles])
    ahead = car(rng, each) + [10.0, 0.0, 0.0]
    oncoming = np.concatenate([car(rng, each) + [x_m, -4.0, 0.0] for x_m in tiles[:1]])
    sweeps = []
    for number in range(PERIOD):
        xyz = np.concatenate([_shifted(still, number), ahead, _shifted(oncoming, 2 * number)])
        sweeps.append(xyz + [0, 0, GROUND_Z_M])
    return sweeps


def car(rng: np.random.Generator, points: int) -> np.ndarray:
    """Return (n, 3) points on the sides of a car at the origin that stands on the ground."""
    share = rng.uniform(-0.5, 0.5, (points, 3))
    face = np.arange(points) % 4
    for axis in (0, 1):
        share[face // 2 == axis, axis] = np.where(face[face // 2 == axis] % 2, 0.5, -0.5)
    return (share + [0, 0, 0.5]) * CAR_LWH_M


def _shifted(xyz_m: np.ndarray, steps: int) -> np.ndarray:
    """Return points of an endless street some steps later; what falls behind comes again at the front."""
    moved = xyz_m - [steps * STEP_M, 0, 0]
    moved[:, 0] = (moved[:, 0] + REACH_M) % (2.0 * REACH_M) - REACH_M
    return moved


def _as_scanned(xyz_m: np.ndarray) -> np.ndarray:
    """Return where a LiDAR that turns clockwise sees the points while the car drives on."""
    seen = xyz_m.copy()
    for _ in range(10):
        seen[:, 0] = xyz_m[:, 0] + np.arctan2(seen[:, 1], seen[:, 0]) / (2 * np.pi) * STEP_M
    return seen


def write_drive(root: Path, number: int, frames: int, points: int) -> str:
    """Write a drive and return its name."""
    day = root / "2011_09_26"
    folder = day / f"2011_09_26_drive_{number:04d}_sync"
    source = root / f"sweeps_{points}"
    source.mkdir(parents=True, exist_ok=True)
    _write_calibration(day)
    for place, xyz_m in enumerate(street(points)):
        scanned = _as_scanned(xyz_m)
        np.column_stack([scanned, np.full(len(scanned), 0.3)]).astype("<f4").tofile(source / f"{place}.bin")
    picture = np.full((HEIGHT_PX, WIDTH_PX, 3), 90, np.uint8)
    picture[: HEIGHT_PX // 2] = (200, 220, 255)
    picture[15:30, 52:72] = (200, 30, 30)
    Image.fromarray(picture).save(source / "picture.png")
    start = np.datetime64("2011-09-26T13:00:00.000000000", "ns")
    times = start + (np.arange(frames) * FRAME_S * 1e9).astype("timedelta64[ns]")
    text = "\n".join(str(time).replace("T", " ") for time in times) + "\n"
    for sensor in ("velodyne_points", "image_02", "oxts"):
        (folder / sensor / "data").mkdir(parents=True, exist_ok=True)
        (folder / sensor / "timestamps.txt").write_text(text)
    turn_m = np.cos(np.deg2rad(LATITUDE_DEG)) * EARTH_RADIUS_M
    for frame in range(frames):
        _link(folder / f"velodyne_points/data/{frame:010d}.bin", source / f"{frame % PERIOD}.bin")
        if frame % PICTURE_STEPS == 0:
            _link(folder / f"image_02/data/{frame:010d}.png", source / "picture.png")
        longitude = LONGITUDE_DEG + np.rad2deg(frame * STEP_M / turn_m)
        record = [LATITUDE_DEG, longitude, 116.0, *[0.0] * 27]
        (folder / f"oxts/data/{frame:010d}.txt").write_text(
            " ".join(repr(float(value)) for value in record) + "\n"
        )
    return folder.name


def _link(path: Path, target: Path) -> None:
    if not path.is_symlink():
        path.symlink_to(target)


def _write_calibration(folder: Path) -> None:
    def text(values: np.ndarray) -> str:
        return " ".join(repr(float(value)) for value in np.ravel(values))

    folder.mkdir(parents=True, exist_ok=True)
    project = np.array([[72.0, 0, 61.5, 0], [0, 72.0, 17.0, 0], [0, 0, 1, 0]])
    cameras = "".join(
        f"S_rect_0{camera}: {WIDTH_PX} {HEIGHT_PX}\nR_rect_0{camera}: {text(np.eye(3))}\n"
        f"P_rect_0{camera}: {text(project)}\n"
        for camera in range(4)
    )
    (folder / "calib_cam_to_cam.txt").write_text(f"calib_time: 09-Jan-2012 13:57:47\n{cameras}")
    axes = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    (folder / "calib_velo_to_cam.txt").write_text(f"R: {text(axes)}\nT: 0 0 0\n")
    (folder / "calib_imu_to_velo.txt").write_text(f"R: {text(np.eye(3))}\nT: 0 0 0\n")


def run_stage(workspace: Path, stage: str, segment: str) -> tuple[float, float]:
    """Run a stage in a process of its own and return its seconds and its peak in MiB."""
    command = [Path(sys.executable).with_name("upvl"), stage]
    if stage not in ("pca", "train"):
        command += ["--segment", segment]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=workspace, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{stage}: {done.stdout}{done.stderr}")
    line = json.loads((workspace / "out" / "runs.jsonl").read_text().splitlines()[-1])
    if line["stage"] != stage:
        raise SystemExit(f"{stage} was fresh in {workspace}: delete the folder")
    return float(line["seconds"]), float(line["peak_mib"])


def measure(folder: Path, frames: int, points: int, stages: list[str]) -> dict[str, tuple[float, float]]:
    """Make a drive, run all stages up to the last that is asked for, and return what each took."""
    number = frames * 100 + points // 1000
    root = folder / f"drive_{frames}_{points}"
    name = write_drive(root, number, frames, points)
    workspace = on_kitti(folder / f"work_{frames}_{points}", root, [name])
    path = workspace / "stages" / "pca.toml"
    path.write_text(re.sub(r"^images = .*$", "images = 10", path.read_text(), flags=re.MULTILINE))
    path = workspace / "stages" / "train.toml"
    text = re.sub(r"^(steps|check_steps) = .*$", r"\1 = 2", path.read_text(), flags=re.MULTILINE)
    path.write_text(re.sub(r"^batch = .*$", "batch = 1", text, flags=re.MULTILINE))
    found = {}
    for stage in stages:
        found[stage] = run_stage(workspace, stage, name)
        print(f"  {frames} frames, {points} points, {stage}: {found[stage]}", file=sys.stderr, flush=True)
    return found


def table(title: str, names: list[str], columns: list[dict[str, tuple[float, float]]]) -> None:
    """Print seconds and peaks of each stage, a column a drive, and the growth from first to last."""
    print(f"\n{title}")
    print("| stage |" + "".join(f" {name}: s | MiB |" for name in names) + " time grows | peak grows |")
    print("| --- |" + " ---: | ---: |" * len(names) + " ---: | ---: |")
    for stage in columns[0]:
        cells = "".join(f" {column[stage][0]:.1f} | {column[stage][1]:.0f} |" for column in columns)
        seconds, peak = (columns[-1][stage][k] / max(columns[0][stage][k], 1e-9) for k in (0, 1))
        print(f"| {stage} |{cells} x{seconds:.1f} | {100 * (peak - 1):+.0f} % |")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[250, 1000, 4000])
    parser.add_argument("--points", type=int, nargs="+", default=[2000, 4000, 8000])
    parser.add_argument("--stages", nargs="+", default=list(STAGES), help="run no others: their inputs exist")
    parser.add_argument("--detector", action="store_true", help="train for two steps, and run detect")
    parser.add_argument("--folder", type=Path, help="where drives and workspaces are made, and stay")
    given = parser.parse_args()
    stages = given.stages + (["train", "detect"] if given.detector else [])
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        by_frames = [measure(folder, frames, given.points[0], stages) for frames in given.frames]
        by_points = [measure(folder, given.frames[0], points, stages) for points in given.points[1:]]
    names = [f"{frames} frames" for frames in given.frames]
    table(f"Sweeps of {given.points[0]} points", names, by_frames)
    if by_points:
        names = [f"{points} points" for points in given.points]
        table(f"{given.frames[0]} frames", names, [by_frames[0], *by_points])


if __name__ == "__main__":
    main()
