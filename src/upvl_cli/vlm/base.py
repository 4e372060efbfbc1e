"""How vision-language models are opened, and what some of them offer beside `Model` of `types`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from upvl_cli.types import Model


@runtime_checkable
class Speller(Protocol):
    """A model with a vocabulary; one without this takes any string as a word."""

    def unknown_words(self, phrases: Sequence[str]) -> list[tuple[str, str]]:
        """Return each word of the phrases that is likely misspelt, with its likely spelling, or ""."""


@runtime_checkable
class Explainer(Protocol):
    """A model whose pixels were taught a list of concepts, and that can say how near a phrase is to them."""

    def nearest_concepts(self, phrases: Sequence[str], count: int) -> list[list[tuple[str, float]]]:
        """Return, for each phrase, the names of the nearest concepts and their cosines, nearest first.

        Args:
            phrases: Phrases in any words.
            count: How many concepts to return for each, at most.
        """


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
