"""How well a network finds CamVid's classes by words alone."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from phrases import WORDS
from PIL import Image
from torch.nn import functional

from upvl_cli.types import Array
from upvl_cli.vlm.mini_text import MiniText


class Score(NamedTuple):
    """Mean IoU over the 11 classes: by their own words, by synonyms that no training saw, and each class's.

    `rounds` has the words of each count and its mean IoU.
    """

    words: float
    synonyms: float
    each: tuple[float, ...]
    rounds: tuple[tuple[tuple[str, ...], float], ...]


def camvid_miou(
    embed: Callable[[Array], Array], text: MiniText, root: Path, split: str, every: int = 1
) -> Score:
    """Score the pictures of a split; `embed` gives (h', w', d) features of a picture."""
    classes = [line for line in (root / "classes.txt").read_text().splitlines() if line][:11]
    concepts = tomllib.loads(WORDS.read_text(encoding="utf-8")).values()
    kept = {name: concept["test"] for name in classes for concept in concepts if name in concept["words"]}
    rounds = [classes, *([kept[name][turn % len(kept[name])] for name in classes] for turn in range(3))]
    tables = [torch.tensor(text.embed(words)) for words in rounds]
    confusion = np.zeros((len(rounds), 11, 11), dtype=np.int64)
    for path in sorted((root / split).glob("*.jpg"))[::every]:
        label = np.asarray(Image.open(root / f"{split}annot" / f"{path.stem}.png"))
        features = torch.tensor(embed(np.asarray(Image.open(path).convert("RGB")))).permute(2, 0, 1)[None]
        with torch.inference_mode():
            for number, table in enumerate(tables):
                likeness = torch.einsum("ndhw,kd->nkhw", features, table)
                full = functional.interpolate(likeness, label.shape, mode="bilinear")
                named = full.argmax(1)[0].numpy()
                known = label < 11
                confusion[number] += np.bincount(label[known] * 11 + named[known], minlength=121).reshape(
                    11, 11
                )
    return Score(
        float(iou(confusion[0]).mean()), float(np.mean([iou(c).mean() for c in confusion[1:]])),
        tuple(np.round(iou(confusion[0]), 3).tolist()),
        tuple((tuple(words), float(iou(of).mean())) for words, of in zip(rounds, confusion, strict=True)),
    )  # fmt: skip


def iou(confusion: np.ndarray) -> np.ndarray:
    """(c,) of a (true, named) table."""
    right = np.diag(confusion)
    return np.nan_to_num(right / (confusion.sum(0) + confusion.sum(1) - right))
