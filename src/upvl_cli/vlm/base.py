"""What every vision-language model offers: pictures and words as vectors of one space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class BackgroundRule:
    """When a feature counts as background: the cosine scale belongs to the model (UP-VL, Section 3.2).

    A point is background where max cos(f, background words) - max cos(f, `against`) >= `threshold`;
    without words to compare with that is the paper's own rule, cos >= eps_bg.

    Attributes:
        against: Words that background is compared with, for models whose cosines have an offset.
        threshold: eps_bg on the scale of this model.
    """

    against: tuple[str, ...]
    threshold: float


class Model(Protocol):
    """A vision-language model; its image network is loaded when the first picture is embedded."""

    @property
    def name(self) -> str:
        """Its name, for people."""

    @property
    def dim(self) -> int:
        """Length d of its vectors."""

    @property
    def background(self) -> BackgroundRule:
        """Its own calibrated background rule."""

    def embed_text(self, words: Sequence[str]) -> Floats:
        """(t, d) float32 vectors of length 1, one a word or phrase."""

    def embed_image(self, rgb: Array) -> Floats:
        """(h', w', d) float32 dense features of an (h, w, 3) uint8 picture, of any length.

        The cells cover the picture evenly: pixel (u, v), whose centre is at (u + 0.5, v + 0.5) from the corner,
        lies in the cell coordinates ((u + 0.5) w' / w - 0.5, (v + 0.5) h' / h - 0.5).
        """


@runtime_checkable
class Speller(Protocol):
    """A model that knows which words there are; one without this takes any string for a word."""

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Each word of the phrases that is likely misspelt, with the spelling that was perhaps meant, or ""."""


@dataclass(frozen=True)
class Adapter:
    """How one family of models is opened.

    Attributes:
        files: From what follows the colon of `model` in vlm.toml, the files that make the model: their content
            is its fingerprint, part of the stamp of every shard that it makes. Loads no network.
        open: Opens it; from the same text.
        example: A value of `model`, for messages.
        version: Raised by hand when the code gives other features for equal weights; part of the stamp as well.
    """

    files: Callable[[str], tuple[Path, ...]]
    open: Callable[[str], Model]
    example: str
    version: int = 1
