"""Estimate the poses of drives from their sweeps alone, and print how well the sweeps then fit each other.

    python bench/odometry.py parquet ../shared/data/lyft

For each drive: length of the path, distance and turn from its first pose to its last, and the residual: the mean
distance, cut off at 0.5 m, of a point above the road from the nearest point of the sweep before, beside the same with
the car taken to stand (points of the road are left out: its rings fall on rings, however the car moves).
Where the drive has poses of its own: how far the end of the path is off. Poses that
the drive has are not used.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.config.toml import load
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.geometry.se3 import apply, compose, inverse
from upvl_cli.perception.odometry.lidar_odometry import estimate_poses
from upvl_cli.perception.odometry.smoothing import smooth_path
from upvl_cli.stages.odometry import OdometryConfig
from upvl_cli.types import Drive

SAMPLE = 4000  # points of a sweep
PAIRS = 20  # of neighboring sweeps
NEAR_M, FAR_M = 3.0, 60.0
ABOVE_ROAD_M = 0.5
CUT_M = 0.5


def residuals_m(drive: Drive, poses: np.ndarray) -> np.ndarray:
    """Return (p, 2) mean distances with the poses, and with the car taken to stand."""
    rng = np.random.default_rng(0)
    rows = []
    for step in np.unique(np.linspace(1, len(poses) - 1, PAIRS).astype(int)):
        before, here = (drive.points(drive.frames[number].index).xyz_ego_m for number in (step - 1, step))
        here = here[(np.linalg.norm(here, axis=1) > NEAR_M) & (np.linalg.norm(here, axis=1) < FAR_M)]
        here = here[here[:, 2] > drive.ground_z_m + ABOVE_ROAD_M]
        here = here[rng.permutation(len(here))[:SAMPLE]]
        tree = cKDTree(before)
        moved = apply(compose(inverse(poses[step - 1]), poses[step]), here)
        rows.append([np.minimum(tree.query(places)[0], CUT_M).mean() for places in (moved, here)])
    return np.array(rows)


def main() -> int:
    """Print a line a drive."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", help="name of the dataset, as in stages/raw.toml")
    parser.add_argument("root", type=Path, help="folder of the drives")
    arguments = parser.parse_args()
    config = load(OdometryConfig, Path(__file__).parents[1] / "stages" / "odometry.toml")
    dataset = dataset_family(arguments.dataset).open(arguments.root, None)
    for segment in dataset.segments:
        drive = dataset.open(segment)
        numbers = np.array([frame.index for frame in drive.frames])
        sweeps = (drive.points(number).xyz_ego_m for number in numbers.tolist())
        poses = smooth_path(estimate_poses(sweeps, config.kiss_icp), numbers, config.smoothing)
        length_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
        whole = compose(inverse(poses[0]), poses[-1])
        turn_deg = np.degrees(np.arctan2(whole[1, 0], whole[0, 0]))
        hertz = 1e9 * (len(numbers) - 1) / max(drive.frames[-1].time_ns - drive.frames[0].time_ns, 1)
        residual = np.median(residuals_m(drive, poses), axis=0) * 100 if len(poses) > 1 else np.zeros(2)
        print(
            f"{segment}: {len(numbers)} sweeps at {hertz:.1f} Hz, path {length_m:.2f} m, first to last "
            f"{np.linalg.norm(whole[:3, 3]):.2f} m and {turn_deg:.2f} degrees; residual {residual[0]:.1f} cm, "
            f"with the car taken to stand {residual[1]:.1f} cm"
        )
        if drive.world_from_ego is not None:
            given = compose(inverse(drive.world_from_ego[0]), drive.world_from_ego[-1])
            off_m = np.linalg.norm(given[:3, 3] - whole[:3, 3])
            given_m = np.linalg.norm(np.diff(drive.world_from_ego[:, :3, 3], axis=0), axis=1).sum()
            share = off_m / max(given_m, 1e-9)
            print(f"  end of the path {off_m:.2f} m off the drive's own, {share:.2%} of {given_m:.1f} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
