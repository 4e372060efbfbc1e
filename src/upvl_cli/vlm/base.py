"""What every vision-language model offers: pictures and words as vectors of one space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from upvl_cli.types import Model


@runtime_checkable
class Speller(Protocol):
    """A model that knows which words there are; one without this takes any string for a word."""

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Each word of the phrases that is likely misspelt, with the spelling that was perhaps meant, or ""."""


@dataclass(frozen=True)
class ModelFamily:
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
