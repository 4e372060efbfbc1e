"""The training pictures in memory, and batches of random crops of them, with things pasted from one into another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageEnhance, ImageFilter
from torch.utils.data import IterableDataset

from upvl_cli.types import Array

VOID = 255
MADE = 16  # labels of the city begin here, those of CamVid at 0
THINGS = ("pole", "traffic sign", "fence", "car", "pedestrian", "bicyclist")  # of CamVid: what can be cut out
PASTED = 0.5  # of the crops get things from another one
LEAST = 12  # of each sixteenth pixel: what is smaller is not sought


@dataclass(frozen=True)
class Picture:
    """(h, w, 3) uint8 and (h, w) uint8 labels: a class of CamVid, `MADE` + a name of the city, or `VOID`."""

    rgb: Image.Image
    label: Image.Image

    def counts(self) -> Array:
        """(256,) how many of each sixteenth pixel have each label."""
        return np.bincount(np.asarray(self.label)[::4, ::4].ravel(), minlength=VOID + 1)


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
                found.append(Picture(_rgb(path), Image.fromarray(np.asarray(label) + np.uint8(MADE))))
    return found, names


def _rgb(path: Path) -> Image.Image:
    with Image.open(path) as image:
        return image.convert("RGB")


@dataclass(frozen=True)
class Source:
    """Pictures to crop.

    Attributes:
        pictures: Them.
        scales: How much smaller and larger they may get.
        crops: How many of them a batch has.
        sought: Share of the crops that have a thing in them, of a label drawn evenly (as rare classes are
            sampled by Hoyer et al., "DAFormer", CVPR 2022): most of a street is road and walls.
    """

    pictures: list[Picture]
    scales: tuple[float, float]
    crops: int
    sought: float

    def showing(self, labels: Array) -> list[tuple[int, list[Picture]]]:
        """Each label that there is, and the pictures that show it."""
        counted = [(picture, picture.counts()) for picture in self.pictures]
        shown = [(label, [picture for picture, of in counted if of[label] >= LEAST]) for label in labels]
        return [(label, pictures) for label, pictures in shown if pictures]


class Batches(IterableDataset[tuple[Array, Array]]):
    """Endless batches of crops: scale, place, mirror, light, colour, blur and pasted things by chance.

    Things go from any source to any other: lorries of the city into real streets, real people into the city
    (after ClassMix, Olsson et al., WACV 2021; with true labels on both sides).
    """

    def __init__(self, sources: list[Source], things: Array, size: tuple[int, int], seed: int):
        self.sources, self.things, self.size, self.seed = sources, things, size, seed

    def __iter__(self) -> Iterator[tuple[Array, Array]]:
        worker = torch.utils.data.get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        endless = [self._endless(source, rng) for source in self.sources]
        while True:
            crops = [
                next(of)
                for of, source in zip(endless, self.sources, strict=True)
                for _ in range(source.crops)
            ]
            both = [self._pasted(crop, crops[rng.integers(len(crops))], rng) for crop in crops]
            yield np.stack([rgb for rgb, _ in both]), np.stack([label for _, label in both])

    def _endless(self, source: Source, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
        showing = source.showing(self.things)
        while True:
            for index in rng.permutation(len(source.pictures)):
                if rng.random() < source.sought:
                    label, pictures = showing[rng.integers(len(showing))]
                    picture = pictures[rng.integers(len(pictures))]
                    there = np.argwhere(np.asarray(picture.label) == label)
                    yield self.crop(picture, source.scales, rng, there[rng.integers(len(there))])
                else:
                    yield self.crop(source.pictures[index], source.scales, rng)

    def _pasted(
        self, crop: tuple[Array, Array], other: tuple[Array, Array], rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return the crop with some objects of another one, each at its own place."""
        there = np.intersect1d(other[1], self.things)
        if not len(there) or rng.random() > PASTED:
            return crop
        taken = np.isin(other[1], rng.permutation(there)[: (len(there) + 1) // 2])
        return np.where(taken[..., None], other[0], crop[0]), np.where(taken, other[1], crop[1])

    def crop(
        self,
        picture: Picture,
        scales: tuple[float, float],
        rng: np.random.Generator,
        around: Array | None = None,
    ) -> tuple[Array, Array]:
        """(h, w, 3) float32 pixels, 0 to 255, and (h, w) labels of one crop, which has the pixel `around`."""
        height, width = self.size
        scale = np.exp(rng.uniform(*np.log(scales)))
        stretch = np.exp(rng.uniform(-0.1, 0.1))
        # The part of the picture that becomes the crop; it may reach beyond the edges.
        part_w, part_h = width / (scale * stretch), height / scale
        left, top = (
            _start(whole, part, None if around is None else around[axis], rng)
            for whole, part, axis in ((picture.rgb.width, part_w, 1), (picture.rgb.height, part_h, 0))
        )
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
        """Return the picture in another light."""
        image = ImageEnhance.Brightness(image).enhance(rng.uniform(0.5, 1.5))
        image = ImageEnhance.Contrast(image).enhance(rng.uniform(0.6, 1.4))
        image = ImageEnhance.Color(image).enhance(rng.uniform(0.2, 1.6))
        if rng.random() < 0.25:
            image = image.filter(ImageFilter.GaussianBlur(rng.uniform(0.3, 1.6)))
        return image


def _start(whole: int, part: float, within: float | None, rng: np.random.Generator) -> float:
    """Where a part of a line begins; it lies on the line as far as it can, and has the place that is named."""
    low, high = sorted((0, whole - part))
    if within is None:
        return rng.uniform(low, high)
    return float(np.clip(rng.uniform(within - part, within), low, high))
