"""Renders pictures of the built-in city with what each pixel shows: python training/mini/city_images.py FOLDER.

Half of the drives leave out the kinds that are met most, so that rare ones fill the pictures. No drive
has the kinds that `stages/synthetic.toml` holds out, so that they can be asked for as novel ones.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from upvl_cli.config.toml import load
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.piece import STUFF

NAMES = (*dict.fromkeys([*STUFF, *KINDS]), "sky")
COMMON = ("sedan", "hatchback", "suv", "adult")
FRAMES = 60
SEED = 7_000  # far from the seeds of drives that are evaluated


def render(folder: Path, number: int, every: int) -> int:
    """Write the pictures of one drive; returns how many."""
    usual = load(CityConfig, Path("stages/synthetic.toml"))
    rng = np.random.default_rng([SEED, number])
    rare = number % 2 == 1
    settings = replace(
        usual,
        frames=FRAMES,
        density=float(rng.uniform(0.8, 2.0)),
        clutter=float(rng.choice([0.0, rng.uniform(0.3, 1.5)])),
        rolling_s=0.0,
        light=1.2,
        haze=1.0,
    )
    without = (*usual.held_out, *(COMMON if rare else ()))
    drive = CityDrive(name=f"mini-{number}", seed=(SEED, number), without=without, settings=settings)
    of_name = np.array(
        [NAMES.index(name) for name in drive.scene.names] + [NAMES.index("sky")], dtype=np.uint8
    )
    written = 0
    for frame in range(int(rng.integers(every)), FRAMES, every):
        for camera in drive.cameras:
            stem = folder / f"{number:03d}-{frame:02d}-{camera.name}"
            image, truth = drive.image_with_truth(frame, camera.name)
            Image.fromarray(image.rgb).save(stem.with_suffix(".jpg"), quality=92)
            Image.fromarray(of_name[truth.name]).save(stem.with_suffix(".png"))
            written += 1
    return written


def main() -> None:
    """Render drives in processes of their own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", type=int, default=80)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--every", type=int, default=20, help="frames between pictures")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "names.txt").write_text("\n".join(NAMES) + "\n", encoding="utf-8")
    numbers = range(options.first, options.first + options.drives)
    with ProcessPoolExecutor(os.cpu_count(), initializer=faulthandler.enable) as pool:
        jobs = [pool.submit(render, options.folder, number, options.every) for number in numbers]
        for number, job in zip(numbers, jobs, strict=True):
            print(number, job.result(), flush=True)


if __name__ == "__main__":
    main()
