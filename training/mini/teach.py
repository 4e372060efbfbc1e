"""Writes what teachers see in pictures: python training/mini/teach.py TEACHERS LITE2.pth OUT --camvid .. --idd ..

TEACHERS has yolox_nano.onnx, DeepLab's .tflite and ESPNetv2's .safetensors; one that is not there is left out. OUT
gets NAME.npz of each picture, and NAME.jpg of those that were reduced. A run that was stopped goes on where it was. No
picture of a drive that is scored belongs here.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from espnetv2 import open_espnetv2
from PIL import Image
from teachers import DeepLab, Dense, LiteHead, Yolox

from upvl_cli.types import Array

LARGEST_PX = 1280  # of a side; what is larger is reduced
LABELLED_PX = 640  # the side at which ESPNetv2 sees pictures of data sets with labels, which are small
LEAST_PX = 40  # of a box whose crop is classified
CONTEXT = 1.1  # side of a crop, by the longer side of its box


class Teachers:
    """All teachers that a folder has."""

    def __init__(self, folder: Path, lite2: Path):
        self.yolox = Yolox(folder / "yolox_nano.onnx")
        self.deeplab = [DeepLab(path) for path in sorted(folder.glob("deeplab*.tflite"))]
        self.dense = [Dense(open_espnetv2(path)) for path in sorted(folder.glob("espnetv2*.safetensors"))]
        self.head = LiteHead(lite2)

    def see(self, rgb: Array, long_side: int) -> dict[str, Array]:
        """Return classes of pixels `E` and `D` (void where a teacher is missing), boxes, and shares of their crops."""
        found, void = self.yolox(rgb), np.full(rgb.shape[:2], 255, np.uint8)
        for network in self.dense:
            network.long_side = long_side
        shares = np.zeros((len(found.score), 1000), np.float16)
        large = np.flatnonzero(
            (found.xyxy_px[:, 2:] - found.xyxy_px[:, :2]).max(axis=1, initial=0) >= LEAST_PX
        )
        if len(large):
            shares[large] = self.head([_crop(Image.fromarray(rgb), found.xyxy_px[row]) for row in large])
        return {
            "E": self.dense[0](rgb) if self.dense else void,
            "D": self.deeplab[0](rgb) if self.deeplab else void,
            "xyxy": found.xyxy_px, "score": found.score, "kind": found.kind, "probs": shares,
        }  # fmt: skip


def _crop(picture: Image.Image, xyxy_px: Array) -> Image.Image:
    x0, y0, x1, y1 = xyxy_px
    half, x, y = max(x1 - x0, y1 - y0) * CONTEXT / 2, (x0 + x1) / 2, (y0 + y1) / 2
    return picture.crop((int(x - half), int(y - half), int(x + half), int(y + half)))


_teachers: Teachers  # of a process


def _open(*of: Any) -> None:
    global _teachers  # noqa: PLW0603
    _teachers = Teachers(*of)


def _teach(out: Path, name: str, path: Path) -> str:
    """Write what the teachers see in one picture."""
    picture = Image.open(path).convert("RGB")
    scale = LARGEST_PX / max(picture.size)
    if scale < 1:
        picture = picture.resize([round(side * scale) for side in picture.size], Image.Resampling.BICUBIC)
        picture.save(out / f"{name}.jpg", quality=88)
    seen = _teachers.see(np.asarray(picture), LARGEST_PX if name.startswith("other") else LABELLED_PX)
    np.savez_compressed(out / f"{name}.part.npz", path=str(path), **seen)
    (out / f"{name}.part.npz").replace(out / f"{name}.npz")
    return name


def main() -> None:
    """Write the files that are not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("teachers", "lite2", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--camvid", type=Path, required=True)
    parser.add_argument("--idd", type=Path, required=True)
    parser.add_argument("--other", type=Path, nargs="*", default=[], help="pictures without labels")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    todo = {
        f"camvid-{path.stem}": path
        for split in ("train", "val")
        for path in sorted((options.camvid / split).glob("*.jpg"))
    }
    for path in sorted((options.idd / "leftImg8bit" / "train").glob("*/*.jpg")):
        todo[f"idd-{path.parent.name}-{path.stem.removesuffix('_image')}"] = path
    todo |= {f"other-{path.stem}": path for path in options.other}
    todo = {name: path for name, path in todo.items() if not (options.out / f"{name}.npz").exists()}
    with ProcessPoolExecutor(
        os.cpu_count(), initializer=_open, initargs=(options.teachers, options.lite2)
    ) as pool:
        jobs = [pool.submit(_teach, options.out, name, path) for name, path in todo.items()]
        for number, job in enumerate(jobs, start=1):
            print(f"{number} of {len(jobs)}: {job.result()}", flush=True)


if __name__ == "__main__":
    main()
