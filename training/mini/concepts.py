"""What each pixel of the training pictures is: concepts, the words for them, and what they are a kind of."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from phrases import WORDS

from upvl_cli.types import Array, Bools, Floats
from upvl_cli.vlm.mini_text import MiniText, unit


@dataclass(frozen=True)
class Concepts:
    """The concepts of words.toml.

    Attributes:
        names: (k,) their first words.
        vectors: For each concept (w, d) vectors of its words.
        centres: (k, d) the mean of each, of length 1.
        camvid_first: (c,) the concept that has the word of each class of CamVid.
        camvid: (c, k) which concepts each class may show.
        of_city: Concept of each name of the city.
        parent_vectors: (p, d) words for several concepts.
        parent_of: (p, k) which ones.
    """

    names: tuple[str, ...]
    vectors: tuple[Floats, ...]
    centres: Floats
    camvid_first: Array
    camvid: Bools
    of_city: dict[str, int]
    parent_vectors: Floats
    parent_of: Bools


def load(text: MiniText, camvid: Path) -> Concepts:
    """Read words.toml, without the words that are held out for the test."""
    table = tomllib.loads(WORDS.read_text(encoding="utf-8"))
    concepts = list(table.values())
    names = tuple(concept["words"][0] for concept in concepts)
    vectors = tuple(text.embed_plain(concept["words"]) for concept in concepts)
    classes = [line for line in (camvid / "classes.txt").read_text().splitlines() if line][:11]
    shows = np.array([[concept.get("camvid") == name for concept in concepts] for name in classes])
    of_city = {name: place for place, concept in enumerate(concepts) for name in concept["city"]}
    parents = sorted({word for concept in concepts for word in concept.get("parents", ())})
    parent_of = np.array(
        [
            [word in concept.get("parents", ()) or word in concept["words"] for concept in concepts]
            for word in parents
        ]
    )
    return Concepts(
        names,
        vectors,
        unit(np.array([one.mean(axis=0) for one in vectors])),
        shows.argmax(axis=1),
        shows,
        of_city,
        text.embed_plain(parents),
        parent_of,
    )
