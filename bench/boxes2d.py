"""What 2D boxes are worth to labels: python bench/boxes2d.py --dataset kitti --root ROOT --detector onnx:FILE.

Labels drives with and without 2D boxes, and prints recall of pedestrians and cyclists in view of a camera, class-
agnostic AP of all objects (level 2), and what the 2D boxes say of the labels: how often a right and a wrong label is
seen in one, and how often the name that they vote for is of the label's class. Without --root the drives are those of
the built-in city, and --detector exact takes the exact boxes of its pixels.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.optimize import linear_sum_assignment

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import gather, labelled_frames
from upvl_cli.evaluation.score import detection_scores
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.iou import iou_3d
from upvl_cli.pipeline.presets import make_labels, preset_workspace
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import MatchBoxes2dRow
from upvl_cli.stages.rows import AmodalRow
from upvl_cli.synthetic.kind import CYCLIST, PEDESTRIAN, VEHICLE
from upvl_cli.synthetic.labels import is_labelled
from upvl_cli.types import Labels
from workspaces import on_city, on_drives

RIGHT_IOU, FOUND_IOU = 0.4, 0.25
RANGES_M = (0.0, 20.0, 40.0, 80.0)
MIN_PIXELS = 30  # of a thing in the city's picture: less is no box for a detector either
TYPE_OF_WORD = {
    **dict.fromkeys(("person", "pedestrian"), PEDESTRIAN),
    **dict.fromkeys(("bicycle", "motorcycle", "cyclist", "motorcyclist", "rider"), CYCLIST),
    **dict.fromkeys(("car", "truck", "bus", "train", "vehicle"), VEHICLE),
}
COCO_OF_TYPE = {PEDESTRIAN: "person", CYCLIST: "cyclist", VEHICLE: "car"}


def main() -> None:
    """Label, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", default="synthetic")
    parser.add_argument("--root", type=Path)
    parser.add_argument(
        "--detector", required=True, help="value of boxes2d.toml; exact: those of the city's pixels"
    )
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--drives", type=int, default=2)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--preset", action="append", default=[], help="STAGE.KEY=VALUE beside the detector")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        if options.root:
            on_drives(folder, options.dataset, options.root, [])
        else:
            on_city(folder, frames=options.frames, train=0, val=options.drives)
        base = Workspace(PIPELINE, folder / "stages", folder / "out", "")
        detector = options.detector
        if detector == "exact":
            detector = f"table:{_write_exact_boxes(base, folder / 'exact.parquet')}"
        runs = {"without": base, "with": _with_detector(base, detector, options.preset)}
        for number, (name, workspace) in enumerate(runs.items()):
            done = [base][:number]
            for segment in base.segments:
                for made in make_labels(base, workspace, done, segment, lambda: None):
                    if made.stage == "match-boxes2d":
                        break  # what follows is not looked at
            _print_scores(name, workspace)
        _print_matches(runs["with"])


def _with_detector(base: Workspace, detector: str, values: list[str]) -> Workspace:
    folder = base.stages / "presets" / "bench-boxes2d"
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"boxes2d": f"detector = {json.dumps(detector)}\n"}
    for value in values:
        stage, _, setting = value.partition(".")
        texts[stage] = texts.get(stage, "") + setting.replace("=", " = ", 1) + "\n"
    for stage, text in texts.items():
        (folder / f"{stage}.toml").write_text(text)
    return preset_workspace(base, folder.name)


def _write_exact_boxes(base: Workspace, path: Path) -> Path:
    """Write the boxes around the visible pixels of each road user of the city, as a detector without a fault gives."""
    if path.exists():
        return path
    rows: list[tuple[str, int, str, float, float, float, float, str]] = []
    for segment in base.segments:
        drive = base.dataset.open(segment)
        for frame in drive.frames:
            for camera in drive.cameras:
                _, truth = drive.image_with_truth(frame.index, camera.name)
                for number in np.unique(truth.thing[truth.thing >= 0]).tolist():
                    kind = drive.scene.things[number].kind
                    down, across = np.nonzero(truth.thing == number)
                    if len(down) >= MIN_PIXELS and is_labelled(kind) and kind.type in COCO_OF_TYPE:
                        edges = (across.min(), down.min(), across.max() + 1, down.max() + 1)
                        name = COCO_OF_TYPE[kind.type]
                        rows.append((segment, frame.index, camera.name, *map(float, edges), name))
    columns = ("segment", "frame", "camera", "x1", "y1", "x2", "y2", "name")
    pq.write_table(pa.table(dict(zip(columns, map(list, zip(*rows, strict=True)), strict=True))), path)
    return path


def _print_scores(name: str, workspace: Workspace) -> None:
    settings = replace(
        load(EvalConfig, workspace.stages / "eval.toml"), iou=(0.4, 0.5), range_edges_m=(30.0,)
    )
    material = gather(workspace, "nms", region=None)
    scores = detection_scores(material.without_classes(), settings, moving_only=False)
    both = [100 * score.ap[1] for score in scores if score.objects == "all"]
    print(f"{name:8} AP@0.4 {both[0]:.1f}  AP@0.5 {both[1]:.1f}  boxes {len(material.predictions)}")
    found: Counter[tuple[int, int]] = Counter()
    total: Counter[tuple[int, int]] = Counter()
    for truth_type, range_m, label_iou in _labels_in_view(workspace):
        group = truth_type, int(np.searchsorted(RANGES_M, range_m)) - 1
        total[group] += 1
        found[group] += label_iou >= FOUND_IOU
    for truth_type, word in ((PEDESTRIAN, "pedestrians"), (CYCLIST, "cyclists"), (VEHICLE, "vehicles")):
        edges = [f"{low:g}-{high:g} m" for low, high in zip(RANGES_M, RANGES_M[1:], strict=False)] + [
            "beyond"
        ]
        parts = [
            f"{edges[number]} {found[truth_type, number]}/{total[truth_type, number]}"
            for number in range(len(edges))
            if total[truth_type, number]
        ]
        print(
            f"         {word} found in view (3D IoU {FOUND_IOU:g}): {', '.join(parts) or 'none'}", flush=True
        )


def _labels_in_view(workspace: Workspace) -> Iterator[tuple[int, float, float]]:
    """Yield type, range and best 3D IoU of each human label with a LiDAR point whose centre a camera sees."""
    for segment, truth, row, _ in _frames(workspace):
        cameras = workspace.drive(segment).cameras
        seen = np.any([project(camera, truth.center_m)[2] for camera in cameras], axis=0)
        iou = iou_3d(truth, row.boxes).max(axis=1, initial=0.0) if len(row.boxes) else np.zeros(len(truth))
        for number in np.flatnonzero(seen & (truth.num_points != 0)).tolist():
            yield int(truth.type[number]), float(np.hypot(*truth.center_m[number, :2])), float(iou[number])


def _frames(workspace: Workspace) -> Iterator[tuple[str, Labels, AmodalRow, MatchBoxes2dRow]]:
    """Yield the human labels and the auto labels of each labelled frame, and their 2D boxes."""
    source, frames, _ = labelled_frames(workspace)
    for segment, labelled in frames.items():
        labels, table = source.labels(segment), workspace.table("nms", AmodalRow, segment)
        matches = workspace.table("match-boxes2d", MatchBoxes2dRow, segment)
        known = set(table.frames)
        for frame in labelled.tolist():
            if frame in known:
                yield segment, labels[labels.frame == frame], table[frame], matches[frame]


def _print_matches(workspace: Workspace) -> None:
    """Print how often labels are seen in a 2D box, right and wrong ones, and whether the votes are right."""
    iou_2d: dict[bool, list[float]] = {True: [], False: []}
    votes: Counter[tuple[int, bool]] = Counter()
    for _, truth, row, shown in _frames(workspace):
        iou = (
            iou_3d(row.boxes, truth)
            if len(truth) and len(row.boxes)
            else np.zeros((len(row.boxes), len(truth)))
        )
        rows, columns = linear_sum_assignment(-iou)
        right = dict(zip(rows.tolist(), columns.tolist(), strict=True))
        for box in range(len(row.boxes)):
            is_right = box in right and iou[box, right[box]] >= RIGHT_IOU
            if shown.iou_2d[box] >= 0:
                iou_2d[is_right].append(float(shown.iou_2d[box]))
            if is_right and shown.word[box]:
                kind = int(truth.type[right[box]])
                votes[kind, TYPE_OF_WORD.get(str(shown.word[box])) == kind] += 1
    for is_right, values in iou_2d.items():
        shares = ", ".join(
            f">= {limit:g}: {np.mean(np.array(values) >= limit):.0%}" for limit in (0.2, 0.4, 0.6)
        )
        print(f"iou_2d of {len(values)} {'right' if is_right else 'wrong'} labels in view: {shares}")
    ranks = np.concatenate([iou_2d[True], iou_2d[False]])
    order = np.argsort(np.argsort(ranks, kind="stable"), kind="stable")
    n, m = len(iou_2d[True]), len(iou_2d[False])
    if n and m:
        print(
            f"probability that a right label has the larger iou_2d: {(order[:n].sum() - n * (n - 1) / 2) / n / m:.2f}"
        )
    for kind, word in ((PEDESTRIAN, "pedestrians"), (CYCLIST, "cyclists"), (VEHICLE, "vehicles")):
        right_votes, all_votes = votes[kind, True], votes[kind, True] + votes[kind, False]
        if all_votes:
            print(f"box_word of {word}: right in {right_votes}/{all_votes} boxes with a vote")


if __name__ == "__main__":
    main()
