"""Time and memory to make a whole drive of the built-in city: all sweeps and all pictures.

    python bench/city.py [--frames 40] [--seed 0] [--twice]

Prints seconds, points a sweep, peak memory and a digest of all bytes; with --twice it makes the drive
again and compares. Beside it stands a plain reference of the same run: a million coherent rays against
the city's own ground, by Embree. Exits 1 above 60 s for 40 frames, above 2 GiB, or when the bytes differ.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import sys
import time
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from upvl_cli.runtime.parallel import in_order
from upvl_cli.synthetic.cast import Caster, Rays
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.lidar import directions
from upvl_cli.synthetic.sensors import SENSORS

SETTINGS = Path(__file__).parents[1] / "stages" / "synthetic.toml"
MAX_S_PER_FRAME = 60 / 40
MAX_MIB = 2048


def frame_digest(drive: CityDrive, frame: int) -> tuple[bytes, int]:
    """Digest of all that is made of one frame, and its points."""
    whole = hashlib.sha256()
    points = drive.points(frame)
    for spec in fields(points):
        whole.update(getattr(points, spec.name).tobytes())
    for camera in drive.cameras:
        image = drive.image(frame, camera.name)
        assert image is not None
        whole.update(image.rgb.tobytes())
    return whole.digest(), len(points)


def made(settings: CityConfig) -> tuple[str, float, float]:
    """Digest of a drive, seconds to make it, mean points of a sweep."""
    started = time.perf_counter()
    drive = City(settings).open("train-000")
    with threadpool_limits(1):  # as `upvl` runs: threads over frames, and none below them
        frames = list(in_order(lambda frame: frame_digest(drive, frame.index), drive.frames))
    seconds = time.perf_counter() - started
    digest = hashlib.sha256(b"".join(part for part, _ in frames)).hexdigest()[:16]
    return digest, seconds, float(np.mean([count for _, count in frames]))


def plain_s(settings: CityConfig) -> float:
    """Seconds for a million rays against what stands still, without anything else."""
    caster = Caster(replace(City(settings).open("train-000").scene, things=()))
    _, way, _, _ = directions(SENSORS["waymo"])
    ways = np.resize(way, (1_000_000, 3)).astype(np.float32)
    rays = Rays(
        np.tile(np.float32([0, -2, 2]), (len(ways), 1)), ways, np.zeros(len(ways), np.int64), np.zeros(1)
    )
    started = time.perf_counter()
    caster.cast(rays, reach_m=80.0)
    return time.perf_counter() - started


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--twice", action="store_true", help="make it again and compare the bytes")
    arguments = parser.parse_args()
    settings = replace(
        CityConfig(**tomllib.loads(SETTINGS.read_text())), frames=arguments.frames, seed=arguments.seed
    )
    digest, seconds, points = made(settings)
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    reference_s = plain_s(settings)
    per_frame_s = seconds / arguments.frames
    print(
        f"{arguments.frames} frames in {seconds:.1f} s, {per_frame_s:.2f} s a frame (bar {MAX_S_PER_FRAME})"
    )
    print(f"a million plain rays: {reference_s:.2f} s; a frame takes {per_frame_s / reference_s:.2f} x that")
    print(f"{points:,.0f} points a sweep, peak {peak_mib:.0f} MiB (bar {MAX_MIB}), bytes {digest}")
    same = True
    if arguments.twice:
        again, _, _ = made(settings)
        same = again == digest
        print("made again: the same bytes" if same else f"made again: OTHER bytes, {again}")
    sys.exit(per_frame_s > MAX_S_PER_FRAME or peak_mib > MAX_MIB or not same)


if __name__ == "__main__":
    main()
