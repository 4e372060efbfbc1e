"""The model that ships: small, made here, and enough to tell cars from trees. See docs/model-card.md."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.types import Array, Floats
from upvl_cli.vlm.base import BackgroundRule
from upvl_cli.vlm.mini_text import MiniText

if TYPE_CHECKING:
    from torch import Tensor

WEIGHTS = Path(__file__).with_name("weights")
# Background is what is nearer to its words than to these, by more than chance; docs/log.md has the figures.
OBJECTS = (
    "car", "vehicle", "parked vehicle", "sedan", "truck", "bus", "van", "minivan", "school bus", "pickup truck",
    "ambulance", "fire truck", "human", "person", "pedestrian", "cyclist", "bicycle",
)  # fmt: skip
FILES = ("mini_image.safetensors", "mini_text.safetensors", "mini_phrases.txt", "mini_tokenizer.json")


def files(weights: str) -> tuple[Path, ...]:
    """The files that make the model.

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
        """(t, d) vectors of length 1."""
        return self.text.embed(words)

    def embed_image(self, rgb: Array) -> Floats:
        """(h / 4, w / 4, d) features, rounded up."""
        import torch
        from torch.nn import functional

        from upvl_cli.vlm.mini_network import CELL, STRIDE

        height, width, _ = rgb.shape
        pixels = torch.tensor(rgb).permute(2, 0, 1)[None].float()
        # Stretched by a pixel or two where a side is no whole number of cells: they cover the picture evenly.
        wide, high = -(-width // CELL), -(-height // CELL)
        size = (high * CELL, wide * CELL)
        pad = (0, -size[1] % STRIDE, 0, -size[0] % STRIDE)
        with torch.inference_mode():
            if size != (height, width):
                pixels = functional.interpolate(pixels, size, mode="bilinear", align_corners=False)
            features: Tensor = self._network(functional.pad(pixels, pad, mode="replicate"))
        return np.asarray(features[0, :, :high, :wide].permute(1, 2, 0).float().numpy())

    @cached_property
    def _network(self) -> Any:
        """The image network, its norms folded into its convolutions, traced so that oneDNN fuses what it can."""
        from safetensors.torch import load_file

        from upvl_cli.vlm.mini_network import MiniNetwork

        network = MiniNetwork(self.dim)
        weights = {name: value.float() for name, value in load_file(WEIGHTS / FILES[0]).items()}
        network.load_state_dict(weights, strict=False)  # the norms' counters are of no use here
        return network.train(False).fused()
