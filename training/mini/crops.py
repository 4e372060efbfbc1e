"""Batches of random crops, made on the device that trains: scale, place, mirror, light, blur, and things pasted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from pictures import Picture
from torch import Tensor
from torch.nn import functional

from upvl_cli.types import Bools

PASTED = 0.5  # of the crops get things from another one


class Batch(NamedTuple):
    """(n, 3, h, w) pictures 0 to 255, (n, h, w) labels and objects, both 0 for none."""

    rgb: Tensor
    label: Tensor
    object_: Tensor


class Source(NamedTuple):
    """Pictures to crop: how much smaller and larger they get, crops of a batch, and the share around a sought thing."""

    pictures: list[Picture]
    scales: tuple[float, float]
    crops: int
    sought: float


class Crops:
    """Endless batches.

    Things go from any source to any other: lorries of the city into real streets, real people into the city
    (after ClassMix, Olsson et al., WACV 2021; with labels on both sides). Crops around a thing of a label drawn evenly
    show rare classes (as Hoyer et al., "DAFormer", CVPR 2022, sample them).
    """

    def __init__(self, sources: list[Source], things: Bools, size: tuple[int, int], device: str, seed: int):
        self.sources, self.size, self.device = sources, size, device
        self.rng = np.random.default_rng(seed)
        self.things = torch.tensor(things, device=device)
        self.held: dict[int, tuple[Tensor, Tensor]] = {}
        self.showing = []
        for source in sources:
            labels = [
                number
                for number in np.flatnonzero(things)
                if any(int(number) in p.places for p in source.pictures)
            ]
            self.showing.append([(n, [p for p in source.pictures if n in p.places]) for n in labels])
            for picture in source.pictures:
                both = np.stack([picture.label.astype(np.float32), picture.number.astype(np.float32)])
                rgb = torch.tensor(picture.rgb, device=device).permute(2, 0, 1).contiguous()
                self.held[id(picture)] = rgb, torch.tensor(both, device=device)

    def batch(self) -> Batch:
        """Return the next one."""
        crops = [
            self._crop(source, showing)
            for source, showing in zip(self.sources, self.showing, strict=True)
            for _ in range(source.crops)
        ]
        rgb, maps = torch.cat([one for one, _ in crops]), torch.cat([one for _, one in crops])
        rgb = self._lit(rgb)
        rgb, maps = self._pasted(rgb, maps)
        return Batch(self._worn(rgb), maps[:, 0].long(), maps[:, 1].long())

    def _crop(self, source: Source, showing: list[tuple[int, list[Picture]]]) -> tuple[Tensor, Tensor]:
        rng, (high, wide) = self.rng, self.size
        within = None
        if showing and rng.random() < source.sought:
            number, pictures = showing[rng.integers(len(showing))]
            picture = pictures[rng.integers(len(pictures))]
            places = picture.places[number]
            within = places[rng.integers(len(places))]
        else:
            picture = source.pictures[rng.integers(len(source.pictures))]
        rgb, maps = self.held[id(picture)]
        height, width = rgb.shape[1:]
        scale = float(np.exp(rng.uniform(*np.log(source.scales))))
        part = high / scale, wide / scale * float(np.exp(rng.uniform(-0.1, 0.1)))
        y = _start(height, part[0], None if within is None else float(within[0]), rng)
        x = _start(width, part[1], None if within is None else float(within[1]), rng)
        mirror = -1.0 if rng.random() < 0.5 else 1.0
        theta = torch.tensor(
            [
                [
                    [mirror * part[1] / width, 0, (2 * x + part[1]) / width - 1],
                    [0, part[0] / height, (2 * y + part[0]) / height - 1],
                ]
            ],
            device=self.device,
        )
        grid = functional.affine_grid(theta, [1, 3, high, wide], align_corners=False)
        pixels = rgb[None].float()
        if scale < 0.8:  # else small things alias
            pixels = functional.avg_pool2d(functional.pad(pixels, (0, 1, 0, 1), mode="replicate"), 2, 1)
        return (
            functional.grid_sample(pixels, grid, mode="bilinear", padding_mode="zeros", align_corners=False),
            functional.grid_sample(
                maps[None], grid, mode="nearest", padding_mode="zeros", align_corners=False
            ),
        )

    def _uniform(self, count: int, low: float, high: float) -> Tensor:
        drawn = self.rng.uniform(low, high, count).astype(np.float32)
        return torch.tensor(drawn, device=self.device)[:, None, None, None]

    def _lit(self, rgb: Tensor) -> Tensor:
        """Return the pictures in another light."""
        n = len(rgb)
        rgb = 255 * (rgb / 255).clamp(0, 1) ** self._uniform(n, 0.75, 1.35)
        rgb = rgb * self._uniform(n, 0.55, 1.5)
        mean = rgb.mean(dim=(1, 2, 3), keepdim=True)
        rgb = mean + (rgb - mean) * self._uniform(n, 0.6, 1.4)
        grey = rgb.mean(dim=1, keepdim=True)
        rgb = grey + (rgb - grey) * self._uniform(n, 0.4, 1.5)
        return (rgb * self._uniform(3 * n, 0.9, 1.1).reshape(n, 3, 1, 1)).clamp(0, 255)

    def _pasted(self, rgb: Tensor, maps: Tensor) -> tuple[Tensor, Tensor]:
        n = len(rgb)
        other = torch.tensor(self.rng.permutation(n), device=self.device)
        chosen = torch.tensor(self.rng.random((n, len(self.things))) < 0.5, device=self.device) & self.things
        chosen &= torch.tensor(self.rng.random((n, 1)) < PASTED, device=self.device)
        of = maps[other]
        label = of[:, 0].long()
        taken = torch.gather(chosen, 1, label.flatten(1)).reshape(label.shape)[:, None]
        return torch.where(taken, rgb[other], rgb), torch.where(taken, of, maps)

    def _worn(self, rgb: Tensor) -> Tensor:
        """Return the pictures as poorer cameras see them: blurred, and with noise."""
        n, (high, wide) = len(rgb), self.size
        factor = float(self.rng.uniform(1.3, 2.2))
        small = functional.interpolate(
            rgb, (int(high / factor), int(wide / factor)), mode="bilinear", antialias=True
        )
        blurred = functional.interpolate(small, (high, wide), mode="bilinear")
        rgb = torch.where(self._uniform(n, 0, 1) < 0.25, blurred, rgb)
        noisy = (self._uniform(n, 0, 1) < 0.3) * self._uniform(n, 1, 9)
        return (rgb + torch.randn_like(rgb) * noisy).clamp(0, 255)


def _start(whole: int, part: float, within: float | None, rng: np.random.Generator) -> float:
    """Where a part of a line begins; it lies on the line as far as it can, and has the place that is named."""
    low, high = sorted((0.0, whole - part))
    if within is None:
        return float(rng.uniform(low, high))
    return float(np.clip(rng.uniform(within - 0.9 * part, within - 0.1 * part), low, high))
