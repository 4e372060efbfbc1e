"""The training pictures in memory, and random crops of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageEnhance, ImageFilter
from torch.utils.data import IterableDataset

from upvl_cli.types import Array

VOID = 255


@dataclass(frozen=True)
class Picture:
    """(h, w, 3) uint8 and (h, w) uint8 classes, `VOID` where nobody knows."""

    rgb: Image.Image
    label: Image.Image


def camvid(root: Path, splits: tuple[str, ...]) -> list[Picture]:
    """Pictures of CamVid with the numbers of its classes; the twelfth is void."""
    found = []
    for split in splits:
        for path in sorted((root / split).glob("*.jpg")):
            label = np.asarray(Image.open(root / f"{split}annot" / f"{path.stem}.png"))
            found.append(
                Picture(_rgb(path), Image.fromarray(np.where(label < 11, label, VOID).astype(np.uint8)))
            )
    return found


def city(folder: Path) -> tuple[list[Picture], list[str]]:
    """Pictures of the city, and the names that their labels are places of."""
    names = (folder / "names.txt").read_text(encoding="utf-8").split("\n")[:-1]
    found = []
    for path in sorted(folder.glob("*.jpg")):
        if path.with_suffix(".png").exists():
            with Image.open(path.with_suffix(".png")) as label:
                found.append(Picture(_rgb(path), label.copy()))
    return found, names


def _rgb(path: Path) -> Image.Image:
    with Image.open(path) as image:
        return image.convert("RGB")


class Crops(IterableDataset[tuple[Array, Array]]):
    """Endless random crops: scale, place, mirror, light, colour and blur by chance."""

    def __init__(
        self, pictures: list[Picture], size: tuple[int, int], scales: tuple[float, float], seed: int
    ):
        self.pictures, self.size, self.scales, self.seed = pictures, size, scales, seed

    def __iter__(self):
        worker = torch.utils.data.get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        while True:
            for index in rng.permutation(len(self.pictures)):
                yield self.crop(self.pictures[index], rng)

    def crop(self, picture: Picture, rng: np.random.Generator) -> tuple[Array, Array]:
        """(h, w, 3) float32 pixels, 0 to 255, and (h, w) classes of one crop."""
        height, width = self.size
        scale = np.exp(rng.uniform(*np.log(self.scales)))
        stretch = np.exp(rng.uniform(-0.1, 0.1))
        # The part of the picture that becomes the crop; it may reach beyond the edges.
        part_w, part_h = width / (scale * stretch), height / scale
        left = rng.uniform(min(0, picture.rgb.width - part_w), max(0, picture.rgb.width - part_w))
        top = rng.uniform(min(0, picture.rgb.height - part_h), max(0, picture.rgb.height - part_h))
        placed = (part_w / width, 0, left, 0, part_h / height, top)
        inside = Image.new("L", picture.label.size, 1).transform(
            (width, height), Image.Transform.AFFINE, placed
        )
        rgb = picture.rgb.transform((width, height), Image.Transform.AFFINE, placed, Image.Resampling.BICUBIC)
        label = picture.label.transform(
            (width, height), Image.Transform.AFFINE, placed, Image.Resampling.NEAREST
        )
        pixels = np.asarray(self.lit(rgb, rng)).astype(np.float32)
        classes = np.where(np.asarray(inside) > 0, np.asarray(label), VOID)
        if rng.random() < 0.5:
            pixels, classes = pixels[:, ::-1], classes[:, ::-1]
        if rng.random() < 0.3:
            pixels = pixels + rng.normal(0, rng.uniform(2, 10), pixels.shape).astype(np.float32)
        gains = rng.uniform(0.85, 1.15, 3).astype(np.float32)
        return np.ascontiguousarray(np.clip(pixels * gains, 0, 255)), np.ascontiguousarray(classes)

    @staticmethod
    def lit(image: Image.Image, rng: np.random.Generator) -> Image.Image:
        """The picture in another light."""
        image = ImageEnhance.Brightness(image).enhance(rng.uniform(0.5, 1.5))
        image = ImageEnhance.Contrast(image).enhance(rng.uniform(0.6, 1.4))
        image = ImageEnhance.Color(image).enhance(rng.uniform(0.2, 1.6))
        if rng.random() < 0.25:
            image = image.filter(ImageFilter.GaussianBlur(rng.uniform(0.3, 1.6)))
        return image
