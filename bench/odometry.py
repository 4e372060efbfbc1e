"""Estimate the poses of drives from their sweeps alone, and print how well they are met: one line a case.

    python bench/odometry.py kitti ../shared/data/kitti_raw_b
    python bench/odometry.py parquet ../shared/data/lyft
    python bench/odometry.py synthetic stages --speed 30

Cases: all sweeps, each second, third and fifth; 1.5 s left out; in reverse; turned by 90 degrees; a quarter of the
beams. For each: length of the path, how far its end and its largest step are off the drive's own poses (where it has
some; else how far the end is from the start), the median residual and share of partners of upright points, the frames
that could not be placed, and processor time a sweep. Where the drive has poses, the last line refines them after they
were rounded to 1.1 m.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.geometry.se3 import compose, from_yaw, inverse
from upvl_cli.perception.odometry.lidar_odometry import estimate_trajectory
from upvl_cli.perception.odometry.refinement import refine_poses
from upvl_cli.perception.odometry.source import UncompensatedSweeps
from upvl_cli.perception.odometry.sweep import PreparedSweep, prepare_sweep
from upvl_cli.perception.odometry.trajectory import EstimatedPath
from upvl_cli.stages.odometry import OdometryConfig
from upvl_cli.synthetic import build
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.motion import SAMPLE_HZ
from upvl_cli.types import Drive

STAGES = Path(__file__).parents[1] / "stages"
CONFIG = load(OdometryConfig, STAGES / "odometry.toml")
BEAM_DEG = 0.42  # steps of elevation of the HDL-64E, by which a quarter of the beams is chosen
ROUNDED_M = 1.1  # five decimals of latitude
GAP_S = 1.5
TURN = from_yaw(np.pi / 2, np.zeros(3))


def sweep_of(
    drive: Drive, step: int, *, backwards: bool = False, turned: bool = False, beams: int = 1
) -> PreparedSweep:
    """Return one sweep, as measured where the drive can say that."""
    frame = drive.frames[step]
    points = drive.measured_points(frame.index) if isinstance(drive, UncompensatedSweeps) else None
    offset_s = np.zeros(0) if points is None else points.time_offset_ns / 1e9
    points = drive.points(frame.index) if points is None else points
    xyz = points.xyz_ego_m.astype(np.float64)
    offset_s = offset_s if len(offset_s) else np.zeros(len(xyz))
    elevation = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    kept = np.round((elevation + 90) / BEAM_DEG).astype(int) % beams == 0
    xyz = xyz @ TURN[:3, :3].T if turned else xyz
    sign = -1 if backwards else 1
    time_s = sign * (frame.time_ns - drive.frames[0].time_ns) / 1e9
    lidar = CONFIG.lidar
    return prepare_sweep(xyz[kept], sign * offset_s[kept], time_s, lidar.kiss_icp, lidar.structure)


def line(name: str, drive: Drive, steps: Sequence[int], **how: bool | int) -> EstimatedPath:
    """Print how well a case is met."""
    began = time.process_time()
    path = estimate_trajectory(
        (sweep_of(drive, step, **how) for step in steps), CONFIG.lidar, CONFIG.smoothing
    )
    poses, spent_s = path.world_from_ego, time.process_time() - began
    length_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    if drive.world_from_ego is None:
        against = f"end {np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3]):.2f} m from the start"
    else:
        true = drive.world_from_ego[list(steps)]
        true = compose(true, inverse(TURN)) if how.get("turned") else true
        true = compose(inverse(true[0]), true)
        true_m = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
        off_m = np.linalg.norm(poses[-1, :3, 3] - true[-1, :3, 3])
        moved, given = (compose(inverse(each[:-1]), each[1:]) for each in (poses, true))
        step_m = np.linalg.norm((moved - given)[:, :3, 3], axis=1).max()
        against = f"end {off_m / max(true_m, 1e-9):.2%} off, largest step {100 * step_m:.1f} cm off"
    print(
        f"  {name}: {len(steps)} sweeps, path {length_m:.2f} m, {against}; residual "
        f"{100 * np.nanmedian(path.residual_m):.1f} cm, partners {np.nanmedian(path.inlier_share):.0%}, "
        f"{(~path.is_placed).sum()} not placed, {1000 * spent_s / len(steps):.0f} ms a sweep",
        flush=True,
    )
    return path


def refined_line(drive: Drive, path: EstimatedPath) -> None:
    """Print how well rounded poses are refined."""
    true = drive.world_from_ego
    assert true is not None
    rough = true.copy()
    rough[:, :2, 3] = np.round(true[:, :2, 3] / ROUNDED_M) * ROUNDED_M
    time_s = np.array([(frame.time_ns - drive.frames[0].time_ns) / 1e9 for frame in drive.frames])
    found = refine_poses(rough, path.world_from_ego, time_s, CONFIG.refinement).world_from_ego
    moved = {name: compose(inverse(each[:-1]), each[1:])[:, :3, 3] for name, each in
             (("true", true), ("rough", rough), ("found", found))}  # fmt: skip
    steps_m = {name: np.linalg.norm(each - moved["true"], axis=1).max() for name, each in moved.items()}
    off_m = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1).max()
    print(
        f"  rounded to {ROUNDED_M} m and refined: places at most {off_m:.2f} m off, largest step "
        f"{100 * steps_m['rough']:.0f} cm off before, {100 * steps_m['found']:.1f} cm after"
    )


def city_drive(seed: int, speed_mps: float | None, frames: int) -> Drive:
    """Return a drive of the built-in city, at another speed where one is named."""
    drive = City(replace(load(CityConfig, STAGES / "synthetic.toml"), seed=seed, frames=frames)).open(
        "train-000"
    )
    if speed_mps is None:
        return drive
    traffic = build.traffic

    def faster(*arguments: object, **named: object) -> object:
        made = traffic(*arguments, **named)  # type: ignore[arg-type]
        way, along_m = made.ego
        return replace(made, ego=(way, along_m[0] + speed_mps * np.arange(len(along_m)) / SAMPLE_HZ))

    # Nothing may stand where the car comes by, at 30 m/s in many places.
    with patch.object(build, "traffic", faster), patch.object(build, "_CHECKS", 160):
        assert drive.scene
    return drive


def main() -> int:
    """Print a line a case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", help="name of the dataset, as in stages/raw.toml")
    parser.add_argument("root", type=Path, help="folder of the drives")
    parser.add_argument("--speed", type=float, help="speed of the car in the city, m/s")
    parser.add_argument("--seed", type=int, default=0, help="seed of the city")
    arguments = parser.parse_args()
    if arguments.dataset == "synthetic":
        drives = [city_drive(arguments.seed, arguments.speed, 40)]
    else:
        dataset = dataset_family(arguments.dataset).open(arguments.root, None)
        drives = [dataset.open(segment) for segment in dataset.segments]
    for drive in drives:
        steps = range(len(drive.frames))
        print(drive.name)
        path = line("all sweeps", drive, steps)
        for share in (2, 3, 5):
            line(f"each {share}th sweep", drive, steps[::share])
        first_s = drive.frames[len(steps) // 3].time_ns / 1e9
        kept = [step for step in steps if not 0 < drive.frames[step].time_ns / 1e9 - first_s < GAP_S]
        line(f"{GAP_S} s left out", drive, kept)
        line("in reverse", drive, steps[::-1], backwards=True)
        line("turned by 90 degrees", drive, steps, turned=True)
        line("a quarter of the beams", drive, steps, beams=4)
        if drive.world_from_ego is not None:
            refined_line(drive, path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
