"""Measure what fusing words over a drive gives, on city drives of the split val: python bench/semantics.py.

Prints accuracy and mean IoU of the classes of points against the truth: as each frame says alone, fused by place, and
fused by place and track as `semantics` does; for the points that a camera sees in the frame and for those unseen.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import semantics
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.synthetic.kind import CYCLIST, PEDESTRIAN
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.types import Array
from workspaces import make, on_city

STAGES = ("odometry", "ground", "flow", "pca", "extract-vl", "mask", "propose", "track", "amodal", "nms")
CLASS_OF = {
    "road": ("road", "lane marking", "crosswalk"),
    "sidewalk": ("kerb", "pavement"),
    "terrain": ("grass",),
    "building": ("building", "house"),
    "wall": ("wall",),
    "fence": ("fence",),
    "vegetation": ("hedge", "tree"),
    "pole": ("pole", "street light"),
    "traffic sign": ("traffic sign", "stop sign"),
    "traffic light": ("traffic light",),
    "car": ("sedan", "hatchback", "suv", "pickup", "van", "taxi", "police car"),
    "truck": (
        "box truck", "articulated truck", "dump truck", "concrete mixer", "garbage truck", "fire truck", "crane",
    ),
    "bus": ("bus", "double-decker bus", "school bus"),
    "tram": ("tram",),
    "traffic cone": ("traffic cone",),
    "street furniture": ("bench", "fire hydrant", "post box", "wheelie bin", "bollard"),
}  # fmt: skip
UNSCORED = -1
MOVING_MPS = 0.5


def main() -> None:
    """Label, fuse, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--drives", type=int, default=2)
    parser.add_argument("--keep", type=Path)
    parser.add_argument(
        "--made", type=Path, help="a workspace of the city whose drives have their boxes already"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.made
        if folder is None:
            folder = on_city(
                options.keep or Path(scratch), frames=options.frames, train=0, val=options.drives
            )
            make(folder, *STAGES)
        print_scores(Workspace(PIPELINE, folder / "stages", folder / "out"))


def class_of(name: str, classes: list[str]) -> int:
    """Return the class that a thing of the city belongs to; `UNSCORED` for one that fits none, as a dog."""
    kind = KINDS[name].type if name in KINDS else 0
    found = next((known for known, names in CLASS_OF.items() if name in names), None)
    if found is None and kind == PEDESTRIAN:
        found = "person"
    if found is None and kind == CYCLIST:
        found = "motorcyclist" if "motor" in name or "scooter" in name else "cyclist"
    return classes.index(found) if found in classes else UNSCORED


def print_scores(workspace: Workspace) -> None:
    """Print a line for each way and each choice of points."""
    config = workspace.settings(semantics.STAGE)
    classes = [words[0] for words in config.words]
    ways = {"each frame alone": None, "fused by place": False, "and by track": True}
    total = len(classes)
    confusion = {}
    for segment in workspace.segments:
        if not segment.startswith("val") or not workspace.shard("nms", segment).exists():
            continue
        for way, by_track in ways.items():
            for part, truth, found in _frames(workspace, segment, classes, by_track, config):
                table = confusion.setdefault((way, part), np.zeros((total, total + 1), np.int64))
                np.add.at(table, (truth, found), 1)
    for (way, part), table in sorted(confusion.items(), key=lambda item: item[0][1]):
        right, true, called = np.diag(table[:, :total]), table.sum(axis=1), table[:, :total].sum(axis=0)
        iou = (right / np.maximum(true + called - right, 1))[true > 0]
        print(
            f"{part:16} {way:17} {true.sum():9d} points, with a class {called.sum() / true.sum():.3f}, right "
            f"{right.sum() / true.sum():.3f}, mIoU of {len(iou)} classes {iou.mean():.3f}"
        )


def _frames(
    workspace: Workspace,
    segment: str,
    classes: list[str],
    by_track: bool | None,
    config: semantics.SemanticsConfig,
) -> Iterator[tuple[str, Array, Array]]:
    """Yield, for each frame and choice of points, their true and their found classes."""
    drive = workspace.drive(segment)
    of_name = np.array([class_of(name, classes) for name in drive.scene.names])
    (pca,) = workspace.table("pca", PcaRow)
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    words = [word for class_words in config.words for word in class_words]
    of_word = np.repeat(np.arange(len(classes)), [len(class_words) for class_words in config.words])
    directions = workspace.model.embed_text(words)
    rows = iter(())
    if by_track is not None:
        inputs = ShardInputs(workspace, semantics.STAGE, segment, config)
        rows = semantics.run(inputs if by_track else _WithoutBoxes(inputs), config)
    for row in features:
        _, truth = drive.points_with_truth(row.frame)
        true, seen = of_name[truth.name], row.state == SEEN
        if by_track is None:
            found = np.full(len(true), UNSCORED)
            found[seen] = of_word[pca.basis.cosines(row.feature, directions).argmax(axis=1)]
        else:
            found = next(rows).class_index.astype(np.int64)
        moves = np.linalg.norm(truth.velocity_mps, axis=1) >= MOVING_MPS
        known = true != UNSCORED
        for part, chosen in {
            "seen, stands": seen & ~moves,
            "seen, moves": seen & moves,
            "unseen, stands": ~seen & ~moves,
            "unseen, moves": ~seen & moves,
            "all": np.ones_like(seen),
        }.items():
            yield part, true[known & chosen], found[known & chosen]


class _WithoutBoxes:
    """Inputs of `semantics` without any box: no point belongs to a track."""

    def __init__(self, inputs: ShardInputs) -> None:
        self._inputs = inputs

    def __getattr__(self, name: str) -> object:
        return getattr(self._inputs, name)

    def table(self, name: str, row: type) -> object:
        rows = self._inputs.table(name, row)
        return _NoBoxes(rows) if name == "nms" else rows


class _NoBoxes:
    """Rows of boxes, emptied."""

    def __init__(self, rows: object) -> None:
        self._rows = rows

    def __getitem__(self, frame: int) -> object:
        row = self._rows[frame]
        return replace(
            row,
            **{
                name: getattr(row, name)[:0]
                for name in ("center_m", "size_lwh_m", "heading_rad", "velocity_mps", "track_id", "score")
            },
        )


if __name__ == "__main__":
    main()
