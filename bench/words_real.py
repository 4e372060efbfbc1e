"""What words make of labelled objects of real drives: python bench/words_real.py kitti:../shared/data/kitti_raw_a ...

For each class of the drive's own labels: the share of its seen points that are nearest to each group of words, and the
share of its frames (with 20 seen points or more) in which most points, or the mean of the points, are. No drive that is
asked here took part in the training of `mini`. A drive is DATASET:ROOT.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import GroundRow
from workspaces import make, on_drives

GROUPS = {
    "car": ("car", "van"),
    "truck": ("truck", "lorry"),
    "bus or tram": ("bus", "tram", "train"),
    "pedestrian": ("pedestrian", "person"),
    "cyclist": ("cyclist", "bicycle", "motorcycle"),
}
BACKGROUND = ("road", "building", "tree", "sidewalk", "wall", "fence", "pole", "grass", "traffic sign")
LEAST_POINTS = 20


def main() -> None:
    """Extract, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", nargs="+", help="DATASET:ROOT")
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for drive in options.drives:
            dataset, _, root = drive.partition(":")
            base = options.keep or Path(scratch)
            folder = on_drives(base / Path(root).name, dataset, Path(root), [])
            make(folder, "odometry", "ground", "flow", "pca", "extract-vl")
            workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
            for segment in workspace.segments:
                scored(workspace, segment)


def scored(workspace: Workspace, segment: str) -> None:
    """Print what words make of each class of a drive."""
    names = [*GROUPS, "background"]
    lists = (*GROUPS.values(), BACKGROUND)
    group_of_word = np.repeat(np.arange(len(lists)), [len(words) for words in lists])
    words = workspace.model.embed_text([word for of in lists for word in of])
    (pca,) = workspace.table("pca", PcaRow)
    source = label_source(workspace.raw.dataset, Path(workspace.raw.root), workspace.dataset)
    labels, frames = source.labels(segment), source.frames(segment)
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    grounds = workspace.table("ground", GroundRow, segment)
    points, looks = defaultdict(list), defaultdict(list)
    for frame in frames.tolist():
        row = features[frame]
        seen = (row.state == SEEN) & ~grounds[frame].is_ground
        boxes = labels[labels.frame == frame]
        inside = points_inside(workspace.drive(segment).points(frame).xyz_ego_m[seen], boxes, margin_m=0.0)
        cosines = pca.basis.cosines(row.feature[seen[row.state == SEEN]], words)
        best = np.stack(
            [cosines[:, group_of_word == group].max(axis=1) for group in range(len(lists))], axis=1
        )
        for number in np.flatnonzero(inside.any(axis=1)):
            own = best[inside[number]]
            points[str(boxes.class_name[number])].append(own)
            if len(own) >= LEAST_POINTS:
                looks[str(boxes.class_name[number])].append((own, str(boxes.object_id[number])))
    print(f"{segment}: share of points nearest to each group; then of the looks at an object, by most points")
    for class_name, parts in sorted(points.items()):
        every = np.concatenate(parts)
        print(
            f"  {class_name:12} {len(every):7d} points  "
            + _shares(names, np.bincount(every.argmax(1), minlength=len(names)))
        )
        among = every[:, :3].argmax(1)
        print(f"  {'':12} among vehicle words      " + _shares(names[:3], np.bincount(among, minlength=3)))
        own = looks[class_name]
        if own:
            won = [np.bincount(one.argmax(1), minlength=len(names)).argmax() for one, _ in own]
            print(
                f"  {'':12} {len(own):7d} looks   " + _shares(names, np.bincount(won, minlength=len(names)))
            )
            vehicle = [np.bincount(one[:, :3].argmax(1), minlength=3).argmax() for one, _ in own]
            print(
                f"  {'':12} among vehicle words      " + _shares(names[:3], np.bincount(vehicle, minlength=3))
            )


def _shares(names: list[str], counts: np.ndarray) -> str:
    return "  ".join(
        f"{name} {value:.3f}" for name, value in zip(names, counts / max(counts.sum(), 1), strict=True)
    )


if __name__ == "__main__":
    main()
