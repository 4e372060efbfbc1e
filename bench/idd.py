"""How well a model tells the seven groups of IDD-Lite by words alone: python bench/idd.py ../shared/data/idd_lite.

Mean IoU over the groups of the split val: streets of another continent, in small pictures. Each group has the words of
the kinds that it is made of (Varma et al., "IDD", WACV 2019); a pixel is of the group that has its nearest word.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "training" / "mini"))
from evaluate import iou

from upvl_cli.vlm import model_family

GROUPS = {
    "drivable": ("road", "street", "lane marking"),
    "non-drivable": ("sidewalk", "pavement", "grass", "ground"),
    "living things": ("person", "pedestrian", "rider", "animal"),
    "vehicles": ("car", "truck", "bus", "motorcycle", "bicycle", "van", "auto rickshaw"),
    "roadside objects": (
        "wall",
        "fence",
        "guard rail",
        "pole",
        "traffic sign",
        "traffic light",
        "billboard",
        "curb",
    ),
    "far objects": ("building", "tree", "vegetation", "bridge"),
    "sky": ("sky",),
}


def main() -> None:
    """Print the IoU of each group; exits 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("--model", default="mini")
    parser.add_argument("--every", type=int, default=1)
    options = parser.parse_args()
    family, weights = model_family(options.model)
    model = family.open(weights)
    words = model.embed_text([word for group in GROUPS.values() for word in group])
    group_of_word = np.repeat(np.arange(len(GROUPS)), [len(group) for group in GROUPS.values()])
    confusion = np.zeros((len(GROUPS), len(GROUPS)), dtype=np.int64)
    for path in sorted((options.root / "leftImg8bit" / "val").glob("*/*.jpg"))[:: options.every]:
        name = path.name.replace("_image.jpg", "_label.png")
        label = np.asarray(Image.open(options.root / "gtFine" / "val" / path.parent.name / name))
        features = model.embed_image(np.asarray(Image.open(path).convert("RGB")))
        cosines = np.stack(
            [(features @ words[group_of_word == group].T).max(axis=2) for group in range(len(GROUPS))], 2
        )
        size = (label.shape[1], label.shape[0])
        full = [
            np.asarray(Image.fromarray(one).resize(size, Image.Resampling.BILINEAR))
            for one in np.moveaxis(cosines, 2, 0)
        ]
        found, known = np.argmax(full, axis=0), label < len(GROUPS)
        confusion += np.bincount(label[known] * len(GROUPS) + found[known], minlength=confusion.size).reshape(
            confusion.shape
        )
    each = iou(confusion)
    print("  ".join(f"{name} {value:.3f}" for name, value in zip(GROUPS, each, strict=True)))
    print(f"mIoU of seven groups by words {each.mean():.3f} (bar 0.55)")
    sys.exit(not each.mean() >= 0.55)


if __name__ == "__main__":
    main()
