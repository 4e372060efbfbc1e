"""The training pictures in memory: what each pixel shows, and the objects among them with colours and kinds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from concepts import NOUN_OF, NOUNS, Labels
from phrases import COLOURS
from PIL import Image
from pseudo_labels import CLASSES
from scipy import ndimage

from upvl_cli.types import Array, Bools, Floats, Ints

NONE = -1
LEAST_PX = 60  # of an object whose colour is told
PLACES = 40  # remembered of each label of a picture, to crop around
# Hues of HSV, 0 to 255, up to which a saturated pixel has a colour.
HUES = ((10, "red"), (26, "orange"), (46, "yellow"), (118, "green"), (185, "blue"), (236, None), (256, "red"))


class Object(NamedTuple):
    """What is known of an object beside its label.

    Attributes:
        coloured: Place of "COLOUR NOUN" in `Concepts.coloured`, `NONE` where it is not known.
        share: (1000,) shares of ImageNet's kinds, as a classifier sees it.
        class_: Class of real pictures that a detector gave it.
    """

    coloured: int
    share: Floats | None
    class_: str


@dataclass
class Picture:
    """One picture.

    Attributes:
        rgb: (h, w, 3) uint8.
        label: (h, w) uint8, 0 for void.
        number: (h, w) int32, number of an object, 0 for none; of `objects` from 1, later on of all pictures.
        objects: Those of this picture.
        places: For each label that it shows, (n, 2) rows and columns of pixels of it.
        source: "camvid", "idd", "other" or "city".
    """

    rgb: Array
    label: Array
    number: Ints
    objects: list[Object]
    places: dict[int, Ints]
    source: str


def colour_of(rgb: Array) -> str | None:
    """Return the colour of an object from its (n, 3) pixels; None where it has none that stands out."""
    hsv = np.asarray(Image.fromarray(rgb[None]).convert("HSV"))[0].astype(int)
    bright = hsv[hsv[:, 2] > np.percentile(hsv[:, 2], 30)]  # tyres, windows and shadows have no colour
    vivid = (bright[:, 1] > 105) & (bright[:, 2] > 60)
    if vivid.mean() > 0.4:
        hue = np.digitize(bright[vivid, 0], [limit for limit, _ in HUES])
        count = np.bincount(hue, minlength=len(HUES))
        count[0] += count[-1]
        most = int(count[:-1].argmax())
        return HUES[most][1] if count[most] > 0.6 * vivid.sum() else None
    if vivid.mean() > 0.2:
        return None
    value = np.median(bright[:, 2])
    return "white" if value > 185 else "black" if value < 60 else "grey" if 80 < value < 160 else None


def places_of(label: Array, rng: np.random.Generator) -> dict[int, Ints]:
    """Return pixels of each label, some of every sixteenth pixel."""
    small = label[::4, ::4]
    found = {}
    for number in np.unique(small):
        at = np.argwhere(small == number)
        if number and len(at) >= 6:
            found[int(number)] = at[rng.permutation(len(at))[:PLACES]] * 4
    return found


def coloured_number(noun: str | None, rgb: Array) -> int:
    """Return the place of an object's colour and noun, `NONE` where either is not known."""
    colour = colour_of(rgb) if noun and len(rgb) >= LEAST_PX else None
    return (
        NONE if colour is None or noun is None else NOUNS.index(noun) * len(COLOURS) + COLOURS.index(colour)
    )


class Boxes(NamedTuple):
    """(n, 4) corners x0, y0, x1, y1 in pixels, (n, 1000) shares of ImageNet's kinds, (n,) places in `CLASSES`."""

    xyxy_px: Floats
    share: Floats
    kind: Ints


def street(folder: Path, nouns: dict[int, str], seed: int) -> Iterator[Picture]:
    """Yield the pictures of pseudo_labels.py; `nouns` of labels whose things have a colour."""
    with np.load(folder / "objects.npz") as file:
        every = {name: file[name] for name in ("name", "xyxy", "share", "kind")}
    paths = sorted(folder.glob("*.jpg"))
    of = [every["name"] == path.stem for path in paths]
    boxes = [Boxes(every["xyxy"][here], every["share"][here], every["kind"][here]) for here in of]
    with ProcessPoolExecutor() as pool:
        yield from pool.map(partial(_street_picture, nouns, seed), paths, boxes, chunksize=20)


def _street_picture(nouns: dict[int, str], seed: int, path: Path, boxes: Boxes) -> Picture:
    rgb = np.asarray(Image.open(path).convert("RGB"))
    label = np.asarray(Image.open(path.with_suffix(".png"))) + np.uint8(1)  # void is 255: it becomes 0
    number, objects = np.zeros(label.shape, dtype=np.int32), []
    side = boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2]
    for row in np.argsort(-side.prod(axis=1), kind="stable"):
        x0, y0, x1, y1 = np.rint(boxes.xyxy_px[row]).clip(0).astype(int)
        window = np.s_[y0:y1, x0:x1]
        inside = np.isin(label[window], list(nouns))
        if not inside.any():
            continue
        most = np.bincount(label[window][inside]).argmax()
        coloured = coloured_number(nouns[int(most)], rgb[window][inside])
        objects.append(Object(coloured, boxes.share[row].astype(np.float32), CLASSES[boxes.kind[row]]))
        number[window][inside] = len(objects)
    rng = np.random.default_rng([seed, *path.stem.encode()])
    return Picture(rgb, label, number, objects, places_of(label, rng), path.stem.split("-")[0])


def city(folder: Path, first: int, seed: int) -> Iterator[Picture]:
    """Yield the pictures of city_images.py; their labels begin at `first`."""
    kinds = {"sedan": "car", "double-decker bus": "bus"}
    nouns = [kinds.get(name, NOUN_OF.get(name.replace(" ", "_"))) for name in city_names(folder)]
    paths = [path for path in sorted(folder.glob("*.jpg")) if path.with_suffix(".png").exists()]
    with ProcessPoolExecutor() as pool:
        yield from pool.map(partial(_city_picture, nouns, first, seed), paths, chunksize=20)


def _city_picture(nouns: list[str | None], first: int, seed: int, path: Path) -> Picture:
    rgb, name = np.asarray(Image.open(path).convert("RGB")), np.asarray(Image.open(path.with_suffix(".png")))
    number, objects = np.zeros(name.shape, dtype=np.int32), []
    for place in np.unique(name):
        if (noun := nouns[int(place)]) is None:
            continue
        parts, _ = ndimage.label(name == place)
        for part, window in enumerate(ndimage.find_objects(parts), start=1):
            inside = parts[window] == part
            if (coloured := coloured_number(noun, rgb[window][inside])) != NONE:
                objects.append(Object(coloured, None, ""))
                number[window][inside] = len(objects)
    label = name + np.uint8(first)
    rng = np.random.default_rng([seed, *path.stem.encode()])
    return Picture(rgb, label, number, objects, places_of(label, rng), "city")


def city_names(folder: Path) -> list[str]:
    """Return the names that labels of the city are places of."""
    return (folder / "names.txt").read_text(encoding="utf-8").split("\n")[:-1]


def street_sets(folder: Path) -> list[list[str]]:
    """Return the classes of each label of pseudo_labels.py."""
    return list(json.loads((folder / "sets.json").read_text()))


def nouns_of_sets(sets: list[list[str]]) -> dict[int, str]:
    """Return what things of a label (from 1) are called, of those that are one class."""
    names = {"car": "car", "truck": "truck", "bus": "bus", "train": "tram"}
    return {
        number: names[one[0]] for number, one in enumerate(sets, start=1) if len(one) == 1 and one[0] in names
    }


def numbered(pictures: Sequence[Picture]) -> list[Object]:
    """Return the objects of all pictures, which are numbered from 1 now."""
    objects: list[Object] = []
    for picture in pictures:
        picture.number[picture.number > 0] += len(objects)
        objects += picture.objects
    return objects


def things(labels: Labels, sets: list[list[str]], city: list[str], kinds: Bools) -> Bools:
    """(c,) which labels are of things that can be cut out and sought; `kinds` says which names of the city are."""
    cut = {
        "fence",
        "pole",
        "traffic light",
        "traffic sign",
        "person",
        "rider",
        "car",
        "truck",
        "bus",
        "train",
        "motorcycle",
        "bicycle",
    }
    real = [bool(one) and set(one) <= cut for one in sets]
    return np.array([False, *real, *kinds])[: len(labels.concepts)]
