"""Open and stream a drive of 1 000 frames of each dataset: python bench/open_drives.py [NAME ...] [--frames 1000].

Writes a drive in each layout whose sweeps have 60 000 points (files that are one a sweep are links to one another), and
reads all of its sweeps in a fresh process. Prints the time until the drive is open, sweeps a second of one core, and
the most memory that the process held, libraries included. Exits 1 where a bar is missed. Waymo has a bench
of its own (bench/waymo_speed.py); here it is a drive of many small sweeps.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq

from upvl_cli.datasets.registry import dataset_family
from upvl_cli.errors import BadInput

TESTS = Path(__file__).parents[1] / "tests"
POINTS = 60_000
MAX_OPEN_S, MAX_MIB = 1.0, 300


def sweep(columns: int) -> np.ndarray:
    """Return (n, columns) float32 of a street: rings on the road, walls, intensity 0 to 1."""
    rng = np.random.default_rng(0)
    angle = np.tile(np.linspace(-np.pi, np.pi, POINTS // 60, endpoint=False), 60)
    radius = np.repeat(np.linspace(4, 60, 60), POINTS // 60) + rng.normal(0, 0.02, POINTS)
    values = np.zeros((POINTS, columns), "<f4")
    values[:, 0], values[:, 1], values[:, 2] = radius * np.cos(angle), radius * np.sin(angle), -1.73
    values[:, 3] = rng.uniform(0, 1, POINTS)
    return values


def link_all(files: list[Path], write: Callable[[Path], None]) -> None:
    """Replace files by one that is written once."""
    write(files[0])
    for path in files[1:]:
        path.unlink()
        os.link(files[0], path)


def write_kitti(root: Path, frames: int) -> None:
    """Write a raw drive."""
    from tiny_kitti import write_drive

    drive = write_drive(root, frames=frames, images=False, tracklets=False)
    files = sorted((drive.folder / "velodyne_points/data").glob("*.bin"))
    link_all(files, lambda path: path.write_bytes(sweep(4).tobytes()))


def write_argoverse2(root: Path, frames: int) -> None:
    """Write a log."""
    from datasets.argoverse2.av2_log import write_log

    log = write_log(root, sweeps=frames)
    values = sweep(4)
    table = pa.table(
        {name: values[:, axis].astype(np.float16) for axis, name in enumerate("xyz")}
        | {"intensity": (values[:, 3] * 255).astype(np.uint8)}
        | {"laser_number": (np.arange(POINTS) % 64).astype(np.uint8), "offset_ns": np.zeros(POINTS, np.int32)}
    )
    files = sorted((log.folder / "sensors/lidar").glob("*.feather"))
    link_all(files, lambda path: pyarrow.feather.write_feather(table, path))


def write_nuscenes(root: Path, frames: int) -> None:
    """Write a scene of 20 Hz sweeps."""
    from datasets.nuscenes import nuscenes_tables

    tables = nuscenes_tables.write_nuscenes(root, scenes=0)
    nuscenes_tables.write_scene(tables, "scene-0001", sweeps=frames)
    tables.write()
    values = sweep(5) * np.float32([1, 1, 1, 255, 0])
    values[:, 4] = np.arange(POINTS) // (POINTS // 30)
    files = sorted((*root.glob("samples/LIDAR_TOP/*"), *root.glob("sweeps/LIDAR_TOP/*")))
    link_all(files, lambda path: path.write_bytes(values.tobytes()))


def write_parquet(root: Path, frames: int, row_group_size: int = 1) -> None:
    """Write a points table."""
    path = root / "points/long.parquet"
    path.parent.mkdir(parents=True)
    values = sweep(4).T
    names = ("x_m", "y_m", "z_m", "intensity")
    schema = pa.schema(
        [("frame", pa.int32()), ("time_ns", pa.int64()), *((name, pa.list_(pa.float32())) for name in names)]
    )
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for first in range(0, frames, row_group_size):
            numbers = np.arange(first, min(first + row_group_size, frames))
            columns = {"frame": numbers, "time_ns": numbers * 10**8}
            columns |= {name: [values[axis]] * len(numbers) for axis, name in enumerate(names)}
            writer.write_table(pa.table(columns, schema=schema), row_group_size=row_group_size)


def write_one_group(root: Path, frames: int) -> None:
    """Write a points table with all sweeps in one row group, as pandas writes."""
    write_parquet(root, frames, row_group_size=frames)


def write_waymo(root: Path, frames: int) -> None:
    """Write a segment of small range images."""
    import tiny_waymo

    tiny_waymo.write_v2(root, tiny_waymo.tiny_segment(frames))


MAKERS: dict[str, tuple[str, Callable[[Path, int], None]]] = {
    "kitti": ("kitti", write_kitti),
    "argoverse2": ("argoverse2", write_argoverse2),
    "nuscenes": ("nuscenes", write_nuscenes),
    "parquet": ("parquet", write_parquet),
    "parquet-one-group": ("parquet", write_one_group),
    "waymo": ("waymo", write_waymo),
}


def peak_mib() -> float:
    """Return the most memory that this process held; `ru_maxrss` would have that of the process that started it."""
    status = Path("/proc/self/status")
    if status.is_file():
        return int(status.read_text().partition("VmHWM:")[2].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def stream(name: str, dataset: str, root: Path) -> bool:
    """Print the figures of a drive and return whether a bar is missed."""
    with contextlib.suppress(BadInput):  # loads the adapter, which is not what is timed
        dataset_family(dataset).open(root / "absent", None)
    start = time.perf_counter()
    found = dataset_family(dataset).open(root, None)
    drive = found.open(found.segments[0])
    open_s = time.perf_counter() - start
    start = time.process_time()
    total = sum(len(drive.points(frame.index)) for frame in drive.frames)
    seconds = time.process_time() - start
    mib = peak_mib()
    print(
        f"{name}: {len(drive.frames)} frames of {total / len(drive.frames):.0f} points, open in {open_s:.2f} s "
        f"(bar {MAX_OPEN_S:g}), {len(drive.frames) / seconds:.0f} sweeps/s a core, {mib:.0f} MiB (bar {MAX_MIB})",
        flush=True,
    )
    return open_s > MAX_OPEN_S or mib > MAX_MIB


def main() -> int:
    """Return 1 where a bar is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=f"of {', '.join(MAKERS)}; all when left out")
    parser.add_argument("--frames", type=int, default=1000)
    options = parser.parse_args()
    sys.path.insert(0, str(TESTS))
    missed = False
    for name in options.names or MAKERS:
        dataset, make = MAKERS[name]
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder) / "drives"
            root.mkdir()
            make(root, options.frames)
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                missed |= pool.apply(stream, (name, dataset, root))
            shutil.rmtree(root)
    return int(missed)


if __name__ == "__main__":
    raise SystemExit(main())
