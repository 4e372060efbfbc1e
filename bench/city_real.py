"""How the built-in city's sweeps compare with real ones.

    python bench/city_real.py ../shared/data/kitti_raw_a ../shared/data/kitti_raw_b [--draw FOLDER]

Prints, for the city and each KITTI raw folder, points a sweep, points by range, the share on the ground (by our
ground stage), and how many clusters stand above it and how large they are. With --draw, a bird's-eye view of
one sweep of each is written there, side by side.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from upvl_cli.config.toml import load
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.ground.height import height_above_ground
from upvl_cli.stages.ground import GroundConfig
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.types import Array, Drive

STAGES = Path(__file__).parents[1] / "stages"
EDGES_M = (0, 5, 10, 20, 30, 50, 120)
SWEEPS = 4
REACH_M, PIXELS = 50.0, 600


class Figures(NamedTuple):
    """Means over some sweeps of a drive."""

    points: float
    by_range: Array
    ground: float
    clusters: float
    cluster_points: Array
    intensity: Array


def figures(drive: Drive) -> Figures:
    """Look at some sweeps, evenly from the drive."""
    config = load(GroundConfig, STAGES / "ground.toml")
    found = []
    for frame in drive.frames[:: max(1, len(drive.frames) // SWEEPS)][:SWEEPS]:
        points = drive.points(frame.index)
        xyz = points.xyz_ego_m
        ground = height_above_ground(xyz, drive.ground_z_m, config.map) <= config.max_height_m
        label = dbscan_voxels(xyz[~ground].astype(np.float64), eps_m=0.8, min_points=10, voxel_m=0.3)
        sizes = np.bincount(label[label >= 0])
        share = np.histogram(np.hypot(xyz[:, 0], xyz[:, 1]), EDGES_M)[0] / len(xyz)
        found.append(
            (
                len(xyz),
                share,
                ground.mean(),
                len(sizes),
                np.quantile(sizes, [0.25, 0.5, 0.75, 0.95]),
                np.quantile(points.intensity, [0.1, 0.5, 0.9]),
            )
        )
    return Figures(*(np.mean([row[k] for row in found], axis=0) for k in range(6)))


def above(drive: Drive) -> Array:
    """Draw a sweep from above, brighter where it is higher."""
    frame = drive.frames[len(drive.frames) // 2].index
    xyz = drive.points(frame).xyz_ego_m
    column = ((REACH_M - xyz[:, 1]) * PIXELS / (2 * REACH_M)).astype(int)
    row = ((REACH_M - xyz[:, 0]) * PIXELS / (2 * REACH_M)).astype(int)
    inside = np.flatnonzero((column >= 0) & (column < PIXELS) & (row >= 0) & (row < PIXELS))
    inside = inside[np.argsort(xyz[inside, 2])]
    canvas = np.full((PIXELS, PIXELS), 18, np.uint8)
    canvas[row[inside], column[inside]] = np.clip(70 + 50 * (xyz[inside, 2] - drive.ground_z_m), 50, 255)
    return canvas


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("roots", type=Path, nargs="*", help="folders with KITTI raw drives")
    parser.add_argument("--draw", type=Path, help="write a picture here")
    arguments = parser.parse_args()
    city = City(CityConfig(**tomllib.loads((STAGES / "synthetic.toml").read_text())))
    drives: dict[str, Drive] = {"city": city.open("train-000")}
    for root in arguments.roots:
        dataset = Kitti(root)
        drives[root.name] = dataset.open(dataset.segments[0])
    print(
        f"{'':14} {'points':>8} {'ground':>7} {'clusters':>9} {'points of a cluster':>26} {'intensity':>16}"
    )
    print(f"{'':14} {'':8} {'':7} {'':9} {'25 %   50 %   75 %   95 %':>26} {'10 %  50 %  90 %':>16}")
    looked = {name: figures(drive) for name, drive in drives.items()}
    for name, row in looked.items():
        sizes = " ".join(f"{size:6.0f}" for size in row.cluster_points)
        lit = " ".join(f"{value:5.2f}" for value in row.intensity)
        print(f"{name:14} {row.points:8,.0f} {row.ground:7.2f} {row.clusters:9.0f} {sizes:>26} {lit:>16}")
    rings = [f"{near}-{far} m" for near, far in zip(EDGES_M, EDGES_M[1:], strict=False)]
    print(f"\n{'points by range':14} " + " ".join(f"{ring:>9}" for ring in rings))
    for name, row in looked.items():
        print(f"{name:14}  " + " ".join(f"{share:9.3f}" for share in row.by_range))
    if arguments.draw:
        arguments.draw.mkdir(parents=True, exist_ok=True)
        path = arguments.draw / "city-beside-real.png"
        Image.fromarray(np.concatenate([above(drive) for drive in drives.values()], axis=1)).save(path)
        print(path)


if __name__ == "__main__":
    main()
