"""How well `upvl check` tells a wrong calibration from a right one, without labels.

    python bench/check.py ../shared/data/kitti_raw_a ../shared/data/kitti_raw_b [--city 0 2] [--few]

Each camera is checked as it is, and with its calibration turned by 1 degree about, or moved by 5 cm along, each of
its axes, both ways. Prints the offset that was estimated, its standard deviation and the verdict; `blind` are the
faults of which the check says itself that it would miss them. --city names seeds of the built-in drives; --few
leaves out the faults of the other sign.
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when numpy is imported

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.commands.check import image_sweep_pairs, sample_frames
from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.perception.visual.camera_check import CalibrationOffset, ImageSweepPair, estimate_offset
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.types import Array, Camera, Drive

STAGES = Path(__file__).parents[1] / "stages"
CONFIG = load(CheckConfig, STAGES / "check.toml")
TURN_DEG, MOVE_CM = 1.0, 5.0
SHOWN = np.array([np.rad2deg(1)] * 3 + [100.0] * 3)  # degrees and centimetres


def faults(few: bool) -> dict[str, Array]:
    """Return the injected faults, (6,) degrees about and centimetres along the axes, by name."""
    found = {"as it is": np.zeros(6)}
    for axis in range(6):
        size, unit = (TURN_DEG, "deg about") if axis < 3 else (MOVE_CM, "cm along")
        for sign in (1,) if few else (1, -1):
            found[f"{sign * size:+g} {unit} {'xyz'[axis % 3]}"] = sign * size * (np.arange(6) == axis)
    return found


def misalign(camera: Camera, fault: Array) -> Camera:
    """Return the camera with a fault in its calibration."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.deg2rad(fault[:3])).as_matrix()
    motion[:3, 3] = fault[3:] / 100
    return replace(camera, ego_from_camera=camera.ego_from_camera @ motion)


def seen_by(drive: Drive, camera: Camera) -> list[ImageSweepPair]:
    """Return the pictures that the check uses, with their sweeps."""
    pictures = {frame: drive.image(frame.index, camera.name) for frame in sample_frames(drive, CONFIG)}
    images = {frame: image for frame, image in pictures.items() if image}
    return list(image_sweep_pairs(drive, images, drive.world_from_ego))


def drives(folders: list[Path], seeds: list[int]) -> Iterator[tuple[str, Drive]]:
    """Yield the drives of the KITTI folders, and one of the city for each seed."""
    for folder in folders:
        dataset = Kitti(folder)
        for segment in dataset.segments:
            yield f"{folder.name} {segment[-9:-5]}", dataset.open(segment)
    for seed in seeds:
        settings = load(CityConfig, STAGES / "synthetic.toml", {"seed": seed, "train": 1})
        yield f"city {seed}", City(settings).open("train-000")


def row(found: CalibrationOffset | None) -> str:
    """Return estimate, standard deviation and verdict in one line."""
    if found is None:
        return "too few outlines"
    six, sigma = found.vector * SHOWN, found.sigma * SHOWN
    numbers = " ".join(f"{value:6.2f} ±{spread:5.2f}" for value, spread in zip(six, sigma, strict=True))
    return f"{numbers}  {'FAULTY' if found.is_fault else 'fine'}"


def main() -> None:
    """Run all faults on all cameras."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--city", nargs="*", type=int, default=[])
    parser.add_argument("--few", action="store_true")
    options = parser.parse_args()
    tally: Counter[str] = Counter()
    print(f"{'':30}rotation about x, y, z (degrees), movement along x, y, z (cm)")
    for name, drive in drives(options.folders, options.city):
        for camera in drive.cameras:
            check_one(f"{name} {camera.name}", camera, seen_by(drive, camera), faults(options.few), tally)
    print()
    for key, count in sorted(tally.items()):
        print(f"{key}: {count}")


def check_one(
    name: str, camera: Camera, seen: list[ImageSweepPair], asked: dict[str, Array], tally: Counter[str]
) -> None:
    """Print one camera's rows, and count what is found."""
    start_s = time.process_time()
    print(f"{name}, {len(seen)} pictures")
    kind = "thumbnails" if camera.width_px < 400 else "pictures"
    right = None
    for fault, six in asked.items():
        found = estimate_offset(misalign(camera, six), seen, CONFIG.camera)
        right = found if right is None else right
        blind = right is None or not right.would_detect(six / SHOWN)
        print(f"  {fault:16}{row(found)}{' blind' if six.any() and blind else ''}", flush=True)
        cause = fault.split(maxsplit=1)[1] if six.any() else "right calibrations"
        tally[f"{kind}, {cause}, all"] += 1
        tally[f"{kind}, {cause}, reported"] += bool(found and found.is_fault)
    print(f"  {(time.process_time() - start_s) / len(asked):.1f} s of one core each")


if __name__ == "__main__":
    main()
