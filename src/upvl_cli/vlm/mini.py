"""The model that ships: small, made here, and enough to tell cars from trees. See docs/model-card.md."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm.mini_text import MiniText

CELL = 4  # pixels of the embedded picture a cell of its features
STRIDE = 32  # sides of an embedded picture are multiples of this

if TYPE_CHECKING:
    from torch import Tensor

WEIGHTS = Path(__file__).with_name("weights")
# Background is what is nearer to its words than to these, by more than chance; docs/log.md has the figures.
OBJECTS = (
    "car", "vehicle", "parked vehicle", "sedan", "truck", "bus", "van", "minivan", "school bus", "pickup truck",
    "ambulance", "fire truck", "tram", "garbage truck", "human", "person", "pedestrian", "child", "jogger",
    "person with umbrella", "stroller", "wheelchair user", "cyclist", "bicycle", "motorcyclist", "motorcycle",
    "scooter rider",
)  # fmt: skip
# Pictures are embedded at their own size as far as the budget goes: what is reduced loses what is far. Where the budget
# allows it, once more, mirrored and at a lower resolution: large, near objects are recognized there, and the errors of
# both are independent. docs/log.md has what other sizes give.
BUDGET_PX, MAX_SCALE = 480_000, 1.25
COARSE_SCALE, COARSE_WEIGHT = 0.625, 0.5
FILES = ("mini_image.safetensors", "mini_text.safetensors", "mini_phrases.txt", "mini_tokenizer.json")

# Names of the concepts that pixels were taught, a line each: for people to read, so that no vector depends on them.
CONCEPTS = "mini_concepts.txt"


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model.

    Raises:
        BadSetting: Weights are named, though it has its own.
    """
    if weights:
        raise BadSetting(
            f'vlm.toml: model = "mini:{weights}": mini brings its own weights; write model = "mini"'
        )
    return tuple(WEIGHTS / name for name in FILES)


class Mini:
    """The embedded default (a `Model`)."""

    name = "mini"
    background = BackgroundRule(OBJECTS, 0.08)

    def __init__(self) -> None:
        """Read the tables of words; the network waits for the first picture."""
        from safetensors.numpy import load_file

        phrases = (WEIGHTS / FILES[2]).read_text(encoding="utf-8").split("\n")[:-1]
        self.text = MiniText(load_file(WEIGHTS / FILES[1]), phrases, WEIGHTS / FILES[3])

    @property
    def dim(self) -> int:
        """Length of its vectors."""
        return int(self.text.vectors.shape[1])

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) vectors of length 1."""
        return self.text.embed(words)

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Return words that are in no table (a `Speller`)."""
        return self.text.unknown_words(phrases)

    def nearest_concepts(self, phrases: Sequence[str], count: int) -> list[list[tuple[str, float]]]:
        """Return, for each phrase, the names and cosines of the nearest concepts (an `Explainer`)."""
        names = (WEIGHTS / CONCEPTS).read_text(encoding="utf-8").splitlines()
        cosines = self.text.concept_cosines(phrases)
        nearest = np.argsort(-cosines, axis=1, kind="stable")[:, :count]
        return [
            [(names[number], float(row[number])) for number in order.tolist()]
            for order, row in zip(nearest, cosines, strict=True)
        ]

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h', w', d) features of length 1; small pictures are looked at a second time, mirrored and reduced."""
        import torch
        from torch.nn import functional

        # Several pictures are embedded at once: that is faster than many threads on one.
        torch.set_num_threads(1)
        height, width, _ = rgb.shape
        pixels = torch.tensor(rgb).permute(2, 0, 1)[None].float()
        scale = min((BUDGET_PX / (height * width)) ** 0.5, MAX_SCALE)
        both_px = height * width * scale**2 * (1 + COARSE_SCALE**2)
        with torch.inference_mode():
            features = self._embed_at(pixels, scale)
            if both_px <= BUDGET_PX:
                coarse = self._embed_at(pixels.flip(-1), scale * COARSE_SCALE).flip(-1)
                coarse = functional.interpolate(
                    coarse, features.shape[-2:], mode="bilinear", align_corners=False
                )
                features = functional.normalize(features + COARSE_WEIGHT * coarse, dim=1)
        return np.asarray(features[0].permute(1, 2, 0).numpy())

    def _embed_at(self, pixels: Tensor, scale: float) -> Tensor:
        """Return (1, d, h', w') features of length 1 of a picture resized to whole cells."""
        import torch
        from torch.nn import functional

        high, wide = (max(round(side * scale / CELL), 1) for side in pixels.shape[-2:])
        size = (high * CELL, wide * CELL)
        resized = functional.interpolate(
            pixels, size, mode="bilinear", align_corners=False, antialias=scale < 1
        )
        pad = (0, -size[1] % STRIDE, 0, -size[0] % STRIDE)
        padded = functional.pad(resized, pad, mode="replicate").contiguous(memory_format=torch.channels_last)
        features = self._network(padded)
        return functional.normalize(features[:, :, :high, :wide], dim=1)

    @cached_property
    def _network(self) -> Any:
        """The image network, its norms folded into its convolutions."""
        from safetensors.torch import load_file

        from upvl_cli.vlm.mini_network import MiniNetwork

        network = MiniNetwork(self.dim)
        weights = {name: value.float() for name, value in load_file(WEIGHTS / FILES[0]).items()}
        network.load_state_dict(weights, strict=False)  # the norms' counters are of no use here
        return network.train(False).fuse()
