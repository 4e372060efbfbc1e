"""CLIP from a checkpoint of the user's, with dense features at the resolution of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array, BackgroundRule, Floats
from upvl_cli.vlm import checkpoint
from upvl_cli.vlm.clip_image import ClipImage
from upvl_cli.vlm.clip_text import ClipText

if TYPE_CHECKING:
    from torch import Tensor

OVERLAP = 0.25  # of a window's side, at least: a patch at its rim has not seen what is around it
BATCH = 16  # windows at once
# Words that fit anything. Cosines of CLIP are all within a few tenths and offset by far more than the paper's
# eps_bg, so the only question with an answer is whether background words fit better than these.
NEUTRAL = ("object", "thing", "vehicle", "person")


def files(weights: str) -> tuple[Path, ...]:
    """Return the files that make the model.

    Raises:
        BadInput: It is not a checkpoint of CLIP with safetensors.
    """
    return Clip.files(Clip.folder(weights))


class Clip:
    """CLIP (a `Model`).

    Attributes:
        family: What stands before the colon of `model` in vlm.toml.
        kinds: Values of `model_type` that it reads.
        hints: What to do about others.
        background: Compares with neutral words, because cosines of CLIP have an offset; a start that
            `upvl fit-background-threshold` refines.
    """

    family: ClassVar[str] = "clip"
    kinds: ClassVar[tuple[str, ...]] = ("clip",)
    hints: ClassVar[dict[str, str]] = {"siglip": 'for SigLIP write model = "siglip:FOLDER"'}
    background = BackgroundRule(NEUTRAL, 0.0)

    def __init__(self, weights: str) -> None:
        """Read the configuration; the towers wait for the first word and the first picture.

        Args:
            weights: Folder of a checkpoint, or its name on the Hugging Face hub.
        """
        self.name = f"{self.family}:{weights}"
        self._checkpoint = self.folder(weights)
        self.files(self._checkpoint)
        self._text = ClipText(self._checkpoint)

    @classmethod
    def folder(cls, weights: str) -> Path:
        """Return the folder of the checkpoint; see `checkpoint.folder`."""
        return checkpoint.folder(weights, f'vlm.toml: model = "{cls.family}:{weights}"')

    @classmethod
    def files(cls, folder: Path) -> tuple[Path, ...]:
        """Return the files that make the model; see `checkpoint.files`."""
        return checkpoint.files(folder, cls.kinds, (checkpoint.PREPROCESSOR,), cls.hints)

    @property
    def dim(self) -> int:
        """Length of its vectors."""
        return self._text.dim

    def embed_text(self, words: Sequence[str]) -> Floats:
        """Return (t, d) vectors of length 1."""
        return self._text.embed(words)

    def embed_image(self, rgb: Array) -> Floats:
        """Return (h / patch, w / patch, d) features; a picture smaller than a window is scaled up to one."""
        import torch

        tower = self._image
        pixels = self._pixels(rgb)
        high, wide = pixels.shape[1] // tower.patch, pixels.shape[2] // tower.patch
        corners = list(product(window_starts(high, tower.cells), window_starts(wide, tower.cells)))
        side = tower.cells * tower.patch
        total, count = torch.zeros(high, wide, self.dim), torch.zeros(high, wide, 1)
        with torch.inference_mode():
            for start in range(0, len(corners), BATCH):
                batch = corners[start : start + BATCH]
                places = [(row * tower.patch, column * tower.patch) for row, column in batch]
                windows = torch.stack([pixels[:, v : v + side, u : u + side] for v, u in places])
                features = tower.features(windows.to(tower.device)).cpu()
                for (row, column), window in zip(batch, features, strict=True):
                    window_cells = np.s_[row : row + tower.cells, column : column + tower.cells]
                    total[window_cells] += window
                    count[window_cells] += 1
        return np.asarray((total / count).numpy())

    def _pixels(self, rgb: Array) -> Tensor:
        """Return (3, h, w) normalised pixels of the picture, resized to whole patches and at least a window."""
        import torch
        from PIL import Image

        size = resized_size(rgb.shape[0], rgb.shape[1], self._image.cells, self._image.patch)
        picture = Image.fromarray(rgb).resize(size[::-1], Image.Resampling.BICUBIC)
        scale, mean, std = self._normalisation
        pixels = (np.asarray(picture, dtype=np.float32) * scale - mean) / std
        return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1), dtype=np.float32))

    @cached_property
    def _normalisation(self) -> tuple[float, Floats, Floats]:
        """What pixels are multiplied by, then their mean and standard deviation, (3,) each."""
        path = self._checkpoint / checkpoint.PREPROCESSOR
        content = checkpoint.read_json(path)
        try:
            mean, std = (np.array(content[key], dtype=np.float32) for key in ("image_mean", "image_std"))
            scale = float(content.get("rescale_factor", 1 / 255))
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(
                f"{path}: image_mean, image_std or rescale_factor is missing or no number"
            ) from error
        if mean.shape != (3,) or std.shape != (3,) or not (std > 0).all():
            raise BadInput(f"{path}: image_mean and image_std have to be 3 numbers each, image_std positive")
        return scale, mean, std

    @cached_property
    def _image(self) -> ClipImage:
        return ClipImage(self._checkpoint)


def resized_size(height: int, width: int, cells: int, patch: int) -> tuple[int, int]:
    """Return height and width in pixels, whole patches, of the resized picture that is cut into windows.

    Args:
        height: Height of the picture in pixels.
        width: Width of the picture in pixels.
        cells: Patches along the side of a window; the resized picture is not smaller.
        patch: Side of a patch in pixels.
    """
    scale = max(1.0, cells * patch / min(height, width))
    high, wide = (max(cells, round(side * scale / patch)) * patch for side in (height, width))
    return high, wide


def window_starts(length: int, cells: int) -> list[int]:
    """Return the first cells of windows that cover a line evenly and overlap by a quarter or more.

    Args:
        length: Cells of the line, at least those of a window.
        cells: Cells of a window.
    """
    step = max(1, int(cells * (1 - OVERLAP)))
    count = -(-(length - cells) // step) + 1
    return [round(start) for start in np.linspace(0, length - cells, count)]
