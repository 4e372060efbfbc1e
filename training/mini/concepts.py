"""What the pixels of the training pictures may be: concepts, their words, and the labels that each picture brings."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from phrases import COLOURS, WORDS
from pseudo_labels import CAMVID

from upvl_cli.types import Array, Bools, Floats
from upvl_cli.vlm.mini_text import MiniText

# The word of each class of real pictures; classes of one word ("rider", "bicycle") count as one.
CLASS_WORDS = {
    "road": "road", "sidewalk": "pavement", "building": "building", "wall": "wall", "fence": "fence", "pole": "pole",
    "traffic light": "traffic_light", "traffic sign": "sign", "vegetation": "tree", "terrain": "grass", "sky": "sky",
    "person": "adult", "rider": "cyclist", "car": "car", "truck": "box_truck", "bus": "bus", "train": "tram",
    "motorcycle": "motorcyclist", "bicycle": "cyclist",
}  # fmt: skip
# What things are called beside their colour.
NOUNS = ("car", "truck", "bus", "van", "pickup truck", "tram")
NOUN_OF = {
    "car": "car", "hatchback": "car", "suv": "car", "taxi": "car", "police_car": "car", "pickup": "pickup truck",
    "van": "van", "ambulance": "van", "box_truck": "truck", "articulated_truck": "truck", "dump_truck": "truck",
    "concrete_mixer": "truck", "garbage_truck": "truck", "bus": "bus", "double_decker": "bus", "school_bus": "bus",
    "tram": "tram",
}  # fmt: skip
NEUTRAL = (
    "thing", "object", "stuff", "music", "food", "water", "computer", "book", "money", "idea", "game", "sea", "fish",
    "kitchen", "bed", "phone", "paper", "king", "war", "company", "language", "number", "body", "hand", "eye", "blood",
    "island", "airplane", "boat", "ship", "cow", "horse", "cat", "bird", "snow", "mountain", "desert", "television",
    "shirt", "shoe", "table", "cup", "gun", "guitar", "doctor", "baby food", "planet", "statue",
)  # fmt: skip


class Phrases(NamedTuple):
    """Phrases before their attraction: (n, d) vectors, (n, k) shares of the concepts, (n,) weight of those."""

    plain: Floats
    share: Floats
    near: Floats

    def of(self, rows: Array) -> Phrases:
        """Return some of them."""
        return Phrases(self.plain[rows], self.share[rows], self.near[rows])


@dataclass(frozen=True)
class Labels:
    """What each label of the pictures allows; label 0 is void.

    Attributes:
        concepts: (c, k) concepts that its pixels may show.
        classes: (c, l) words of `CLASS_WORDS` that it may be called, of real pictures; all false for others.
        camvid: (c, 11) the same of CamVid's classes.
        parents: (c, p) 1 where each concept of it has the parent, 0 where none has, else NaN.
    """

    concepts: Bools
    classes: Bools
    camvid: Bools
    parents: Floats


class Concepts:
    """The concepts of words.toml."""

    def __init__(self, text: MiniText):
        self.text = text
        self.table = tomllib.loads(WORDS.read_text(encoding="utf-8"))
        self.names = tuple(self.table)
        self.words = [text.before_attraction(one["words"]) for one in self.table.values()]
        self.parents = sorted({word for one in self.table.values() for word in one.get("parents", ())})
        self.class_concepts = list(dict.fromkeys(CLASS_WORDS.values()))
        self.camvid_concepts = [
            next(n for n, one in self.table.items() if name in one["words"]) for name in CAMVID
        ]

    def phrases(self, words: list[str]) -> Phrases:
        """Return phrases of any words."""
        return Phrases(*self.text.before_attraction(words))

    @property
    def coloured(self) -> Phrases:
        """All nouns in all colours, noun by noun."""
        return self.phrases([f"{colour} {noun}" for noun in NOUNS for colour in COLOURS])

    def of_imagenet(self, kinds: list[str]) -> Bools:
        """(k, 1000) which kinds of ImageNet are which concept; of two kinds of one name ("crane") the later one."""
        out = np.zeros((len(self.names), len(kinds)), dtype=bool)
        last = {name.split(",")[0]: place for place, name in enumerate(kinds)}
        for row, one in enumerate(self.table.values()):
            for kind in one.get("imagenet", ()):
                out[row, last[kind]] = True
        return out

    def may_show(self, class_: str) -> Bools:
        """(k,) concepts that a class of real pictures may show."""
        return np.array([class_ in one["real"] for one in self.table.values()])

    def labels(self, sets: list[list[str]], city: list[str]) -> Labels:
        """Return what labels allow: void, then the sets of real pictures, then the names of the city."""
        real = [[bool(set(one["real"]) & set(classes)) for one in self.table.values()] for classes in sets]
        made = [[name in one["city"] for one in self.table.values()] for name in city]
        concepts = np.array([[False] * len(self.names), *real, *made])
        parent = np.array(
            [
                [word in one.get("parents", ()) or word in one["words"] for word in self.parents]
                for one in self.table.values()
            ]
        )
        mean = concepts @ parent.astype(np.float32) / np.maximum(concepts.sum(axis=1, keepdims=True), 1)
        rows = len(concepts)
        classes, camvid = (
            np.zeros((rows, len(self.class_concepts)), bool),
            np.zeros((rows, len(CAMVID)), bool),
        )
        for row, names in enumerate(sets, start=1):
            for name in names:
                if name in CLASS_WORDS:
                    classes[row, self.class_concepts.index(CLASS_WORDS[name])] = True
                camvid[row] |= [name in of for of in CAMVID.values()]
            if not set(names) <= set(CLASS_WORDS):  # what has no word there could be anything
                classes[row] = camvid[row] = False
        parents = np.where((mean == 0) | (mean == 1), mean, np.nan)
        parents[~concepts.any(axis=1)] = np.nan
        return Labels(concepts, classes, camvid, parents.astype(np.float32))
