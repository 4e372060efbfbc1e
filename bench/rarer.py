"""A KITTI raw drive as a sensor with fewer beams or sweeps would have it: python bench/rarer.py ROOT FOLDER --rings 4.

Writes the drive to FOLDER with each n-th beam (`--rings`) or each n-th sweep (`--sweeps`) alone; all else is linked.
Label it in a workspace whose raw.toml has `dataset = "kitti"` and `root = FOLDER`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from upvl_cli.perception.sensor.beams import beams_by_order
from upvl_cli.perception.sensor.origin import elevations_deg
from upvl_cli.perception.sensor.turn import azimuths_deg

OPTICAL_CENTER_M = np.array([0.0, 0.0, 0.2])  # of the HDL-64E, above its axes: measured by `upvl check`


def main() -> None:
    """Write the drive."""
    parser = argparse.ArgumentParser()
    parser.add_argument("root", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rings", type=int, default=1)
    parser.add_argument("--sweeps", type=int, default=1)
    options = parser.parse_args()
    for day in sorted(path for path in options.root.resolve().iterdir() if path.is_dir()):
        target = options.folder / day.name
        target.mkdir(parents=True)
        for path in sorted(day.iterdir()):
            if path.is_dir() and (path / "velodyne_points").is_dir():
                thin_out(path, target / path.name, options.rings, options.sweeps)
            elif path.is_file():
                (target / path.name).symlink_to(path)


def thin_out(drive: Path, target: Path, rings: int, sweeps: int) -> None:
    """Write one drive with each n-th ring and sweep."""
    lidar = target / "velodyne_points"
    (lidar / "data").mkdir(parents=True)
    for path in sorted(drive.iterdir()):
        if path.name != "velodyne_points":
            (target / path.name).symlink_to(path)
    (lidar / "timestamps.txt").symlink_to(drive / "velodyne_points/timestamps.txt")
    for path in sorted((drive / "velodyne_points/data").glob("*.bin"))[::sweeps]:
        rows = np.fromfile(path, "<f4").reshape(-1, 4)
        rows[ring_of(rows[:, :3]) % rings == 0].tofile(lidar / "data" / path.name)


def ring_of(xyz_m: np.ndarray) -> np.ndarray:
    """Return (n,) the number of the beam of each point, from the lowest on."""
    elevation = elevations_deg(xyz_m, OPTICAL_CENTER_M)
    beams = beams_by_order(azimuths_deg(xyz_m, OPTICAL_CENTER_M), elevation)
    if beams is None:
        raise SystemExit("the sweeps are not stored beam by beam")
    return np.searchsorted((beams[1:] + beams[:-1]) / 2, elevation)


if __name__ == "__main__":
    main()
