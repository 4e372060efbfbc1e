"""Joins labels of pictures with what teachers see: python training/mini/pseudo_labels.py SEEN OUT --camvid .. --idd ..

A pixel gets a set of `CLASSES`: what the data set's own label allows, narrowed where two teachers agree. CamVid's
"car" covers lorries and buses and IDD-Lite's "vehicles" cover bicycles; two of three teachers (two dense networks, one
detector) must say the same class before a pixel is one of them alone. Pictures without labels get what both dense
networks say. OUT gets NAME.jpg, NAME.png (place of each pixel's set in sets.json) and objects.npz: boxes with their
shares of ImageNet's kinds.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from teachers import CITYSCAPES

from upvl_cli.types import Array

CLASSES = (*CITYSCAPES, "object", "animal")
VOID = 255
NUMBER = {name: number for number, name in enumerate(CLASSES)}
DETECTOR_VOTE, AGREED = 1.2, 1.4
VEHICLES = ("car", "truck", "bus", "train")
# What each class of a data set may show. Of CamVid's 11 (SegNet's split) and of IDD-Lite's 7.
CAMVID = {
    "sky": ("sky",), "building": ("building", "wall"), "pole": ("pole",), "road": ("road",), "sidewalk": ("sidewalk",),
    "tree": ("vegetation", "terrain"), "traffic sign": ("traffic sign", "traffic light"), "fence": ("fence",),
    "car": VEHICLES, "pedestrian": ("person",), "bicyclist": ("rider", "bicycle", "motorcycle"),
}  # fmt: skip
IDD = {
    "drivable": ("road",), "non-drivable": ("sidewalk", "terrain"), "living things": ("person", "rider", "animal"),
    "vehicles": ("car", "truck", "bus", "motorcycle", "bicycle"),
    "roadside objects": ("wall", "fence", "pole", "traffic sign", "traffic light", "object"),
    "far objects": ("building", "vegetation"), "sky": ("sky",),
}  # fmt: skip
DETECTED = ("person", "rider", *VEHICLES, "motorcycle", "bicycle")


def votes(teacher: dict[str, Array], use: frozenset[str]) -> Array:
    """Return (c, h, w) how many teachers say each class of `CLASSES`; a box speaks for road users inside of it."""
    height, width = teacher["E"].shape
    counts = np.zeros((len(CLASSES), height, width), dtype=np.uint8)
    for name in ("E", "D"):
        if name in use:
            counts += np.arange(len(CLASSES))[:, None, None] == teacher[name]
    if "Y" in use:
        boxed = np.full((height, width), VOID, dtype=np.uint8)
        for row in np.argsort(teacher["score"], kind="stable"):
            x0, y0, x1, y1 = np.rint(teacher["xyxy"][row]).clip(0).astype(int)
            boxed[y0:y1, x0:x1] = teacher["kind"][row]
        counts += np.arange(len(CLASSES))[:, None, None] == boxed
    return counts


def joined(
    allowed: tuple[tuple[str, ...], ...], label: Array, counts: Array, sets: Sets, least: int
) -> Array:
    """Return (h, w) places of sets: the label's own, or the one class in it that `least` teachers or more say."""
    out = np.full(label.shape, VOID, dtype=np.uint8)
    for number, names in enumerate(allowed):
        here = label == number
        if not here.any():
            continue
        classes = [NUMBER[name] for name in names]
        said = counts[classes][:, here]
        best, most = said.argmax(axis=0), said.max(axis=0)
        clear = (said == most).sum(axis=0) == 1
        places = np.array(
            [*(sets.place((one,)) for one in classes), sets.place(tuple(classes))], dtype=np.uint8
        )
        out[here] = places[np.where((most >= least) & clear, best, len(classes))]
    return out


def whole_objects(places: Array, teacher: dict[str, Array], use: frozenset[str], sets: Sets) -> Array:
    """Return the labels with one class for all pixels of a vehicle in a box: votes of pixels patch an object.

    Both dense networks have a vote by the shares of their pixels, the detector a little more; together they must reach
    what one and a third of them say. Boxes in front (smaller ones) are laid over larger ones.
    """
    kinds = [NUMBER[name] for name in VEHICLES]
    is_vehicle = np.zeros(256, dtype=bool)
    for classes, place in sets.places.items():
        is_vehicle[place] = set(classes) <= set(kinds) or {NUMBER["car"], NUMBER["truck"]} <= set(classes)
    side = teacher["xyxy"][:, 2:] - teacher["xyxy"][:, :2]
    out = places.copy()
    for row in np.argsort(-side.prod(axis=1), kind="stable"):
        if teacher["kind"][row] not in kinds:
            continue
        x0, y0, x1, y1 = np.rint(teacher["xyxy"][row]).clip(0).astype(int)
        window = np.s_[y0:y1, x0:x1]
        inside = is_vehicle[places[window]]
        if inside.mean() < 0.3:
            continue
        said = np.array([(teacher["kind"][row] == kind) * DETECTOR_VOTE for kind in kinds])
        for name in ("E", "D"):
            if name in use:
                said += [(teacher[name][window][inside] == kind).mean() for kind in kinds]
        chosen = (kinds[said.argmax()],) if said.max() >= AGREED else tuple(kinds)
        out[window][inside] = sets.place(chosen)
    return out


class Sets:
    """Sets of classes, each with a place."""

    def __init__(self) -> None:
        self.places: dict[tuple[int, ...], int] = {}

    def place(self, classes: tuple[int, ...]) -> int:
        """Return the place of a set, a new one for one not seen before."""
        return self.places.setdefault(tuple(sorted(classes)), len(self.places))


def agreed(teacher: dict[str, Array], counts: Array, sets: Sets) -> Array:
    """Return (h, w) places of sets of a picture without labels: what two teachers say, else void."""
    places = np.array([sets.place((number,)) for number in range(len(CLASSES))], dtype=np.uint8)
    return np.where(counts.max(axis=0) >= 2, places[counts.argmax(axis=0)], VOID).astype(np.uint8)


def main() -> None:
    """Write the pictures, their labels, the sets and the objects."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seen", type=Path, help="folder of teach.py's files")
    parser.add_argument("out", type=Path)
    parser.add_argument("--camvid", type=Path, required=True)
    parser.add_argument("--idd", type=Path, required=True)
    parser.add_argument("--use", default="E,D,Y", help="teachers that vote: E ESPNetv2, D DeepLab, Y YOLOX")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    use, sets = frozenset(options.use.split(",")), Sets()
    least = 2 if len(use) > 1 else 1
    objects: list[tuple[str, Array, Array, int]] = []
    for path in sorted(options.seen.glob("*.npz")):
        with np.load(path) as file:
            teacher = dict(file)
        picture = Path(str(teacher["path"]))
        source, name = path.stem.split("-")[0], path.stem
        counts = votes(teacher, use)
        if source == "camvid":
            label = np.asarray(
                Image.open(picture.parent.parent / f"{picture.parent.name}annot/{picture.stem}.png")
            )
            classes = (options.camvid / "classes.txt").read_text().splitlines()
            places = joined(tuple(CAMVID.get(one, ()) for one in classes[:11]), label, counts, sets, least)
        elif source == "idd":
            found = picture.stem.replace("_image", "_label.png")
            label = np.asarray(
                Image.open(options.idd / "gtFine" / picture.parent.parent.name / picture.parent.name / found)
            )
            classes = (options.idd / "classes.txt").read_text().splitlines()
            places = joined(tuple(IDD[one] for one in classes[:7]), label, counts, sets, least)
        else:
            places = agreed(teacher, counts, sets)
        if "Y" in use:
            places = whole_objects(places, teacher, use, sets)
        reduced = path.with_suffix(".jpg")
        shutil.copyfile(reduced if reduced.exists() else picture, options.out / f"{name}.jpg")
        Image.fromarray(places).save(options.out / f"{name}.png", optimize=True)
        for box, kind, share in zip(teacher["xyxy"], teacher["kind"], teacher["probs"], strict=True):
            if share.any() and kind != NUMBER["person"]:
                objects.append((name, box, share, int(kind)))
    named = [[CLASSES[number] for number in classes] for classes in sets.places]
    (options.out / "sets.json").write_text(json.dumps(named))
    np.savez_compressed(
        options.out / "objects.npz",
        name=np.array([one[0] for one in objects]), xyxy=np.array([one[1] for one in objects], np.float32),
        share=np.array([one[2] for one in objects], np.float16), kind=np.array([one[3] for one in objects], np.uint8),
    )  # fmt: skip
    print(f"{len(sets.places)} sets, {len(objects)} objects")


if __name__ == "__main__":
    main()
