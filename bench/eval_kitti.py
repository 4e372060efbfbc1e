"""Label KITTI raw drives as shipped, and score the moving objects in the front view.

    python bench/eval_kitti.py ../shared/data/kitti_raw_b [--keep FOLDER]

Prints class-agnostic 3D AP of moving objects by Waymo's definition, tracking scores, and then what is asked
of each object up to 50 m: the share of its frames with 20 points or more in which some auto label covers it
(bird's-eye IoU 0.3), its number of ids, and false moving boxes a frame (those that touch no moving label at
bird's-eye IoU 0.1). Exits 1 when one of these bars is missed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material, gather
from upvl_cli.evaluation.score import TrackScore, detection_scores, track_scores
from upvl_cli.geometry.iou import iou_3d, iou_bev
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, speed_mps
from upvl_cli.pipeline.workspace import Workspace
from workspaces import on_kitti

FAR_M = 50.0
MIN_POINTS = 20
COVERED_IOU, MIN_COVERED = 0.3, 0.7
MAX_IDS = 2
TOUCHED_IOU, MAX_FALSE = 0.1, 1.0


def near(material: Material) -> Material:
    """Return what lies within `FAR_M`."""
    labels, boxes = (
        np.hypot(*side.center_m[:, :2].T) <= FAR_M for side in (material.labels, material.predictions)
    )
    return replace(
        material,
        labels=material.labels[labels],
        points=material.points[labels],
        in_view=material.in_view[labels],
        predictions=material.predictions[boxes],
    )


def frames(truth: Truth, predictions: Predictions) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for each frame which labels and which predictions it has, by row."""
    keys = (
        list(zip(side.sequence.tolist(), side.frame.tolist(), strict=True)) for side in (truth, predictions)
    )
    of_truth, of_predictions = keys
    for key in sorted({*of_truth, *of_predictions}):
        yield (
            np.array([row for row, other in enumerate(of_truth) if other == key], dtype=np.int64),
            np.array([row for row, other in enumerate(of_predictions) if other == key], dtype=np.int64),
        )


def print_scores(name: str, material: Material, settings: EvalConfig) -> None:
    """Print AP and tracking scores of one part of the ground."""
    print(
        f"{name}: {int((speed_mps(material.labels.velocity_mps) >= settings.moving_mps).sum())} moving labels"
    )
    for score in detection_scores(material, settings, moving_only=True):
        if score.objects == "all":
            print(
                f"  AP@{score.iou:g} L1 {score.ap[0]:.3f} L2 {score.ap[1]:.3f}, "
                f"precision {score.precision:.3f}, recall {score.recall:.3f} at the best F1"
            )
    for track in track_scores(material, settings, moving_only=True):
        if track.level == 2:
            shares = (
                f"missed {track.miss:.3f}, false {track.false_positive:.3f}, mismatched {track.mismatch:.3f}"
            )
            identity = idf1(material, settings, track)
            print(
                f"  IoU {track.iou:g}: MOTA {track.mota:.3f}, MOTP {track.motp:.3f}, {shares}, IDF1 {identity:.3f}"
            )


def idf1(material: Material, settings: EvalConfig, track: TrackScore) -> float:
    """Return IDF1 (Ristani et al., 2016) of the moving labels, with the boxes that gave the best MOTA."""
    moving = speed_mps(material.labels.velocity_mps) >= settings.moving_mps
    fast = speed_mps(material.predictions.velocity_mps) >= settings.moving_mps
    truth, boxes = material.labels[moving], material.predictions
    boxes = boxes[fast & (boxes.score >= (track.cutoff or 0.0))]
    names, number = named(truth)
    box_names, box_number = named(boxes)
    shared = np.zeros((names, box_names))
    for labels, here in frames(truth, boxes):
        row, column = np.nonzero(iou_3d(truth[labels], boxes[here]) >= track.iou)
        np.add.at(shared, (number[labels[row]], box_number[here[column]]), 1)
    found = shared[linear_sum_assignment(shared, maximize=True)].sum()
    return float(2 * found / max(len(truth) + len(boxes), 1))


def named(boxes: Truth | Predictions) -> tuple[int, np.ndarray]:
    """Return how many objects there are, and the (n,) number of the object of each box."""
    object_name = np.char.add(np.char.add(boxes.sequence.astype(str), "/"), boxes.object_id.astype(str))
    names, number = np.unique(object_name, return_inverse=True)
    return len(names), number


def covered(truth: Truth, points: np.ndarray, predictions: Predictions, moving_mps: float) -> Iterator[bool]:
    """Print how well each moving object is covered, and yield whether each meets its bars."""
    best, track = np.zeros(len(truth)), np.full(len(truth), "", dtype="<U32")
    for labels, here in frames(truth, predictions):
        iou = iou_bev(truth[labels], predictions[here])
        if iou.size:
            best[labels] = iou.max(axis=1)
            track[labels] = predictions.object_id[here][iou.argmax(axis=1)]
    object_name = np.char.add(
        np.char.add(truth.sequence.astype(str), " object "), truth.object_id.astype(str)
    )
    for name in np.unique(object_name):
        asked = (object_name == name) & (points >= MIN_POINTS)
        if not asked.any() or np.median(speed_mps(truth.velocity_mps[asked])) < moving_mps:
            continue
        hit = asked & (best >= COVERED_IOU)
        share, ids = hit.sum() / asked.sum(), len(np.unique(track[hit]))
        fine = bool(share >= MIN_COVERED and ids <= MAX_IDS)
        print(
            f"{name}: covered in {share:.0%} of {asked.sum()} frames (bar {MIN_COVERED:.0%}), "
            f"{ids} ids (bar {MAX_IDS}) {'ok' if fine else 'MISSED'}"
        )
        yield fine


def false_boxes(material: Material, moving_mps: float) -> float:
    """Return how many boxes a frame touch no moving label."""
    truth = material.labels[speed_mps(material.labels.velocity_mps) >= moving_mps]
    false = 0
    for labels, here in frames(truth, material.predictions):
        iou = iou_bev(material.predictions[here], truth[labels])
        false += int((iou.max(axis=1, initial=0.0) < TOUCHED_IOU).sum())
    return false / max(material.frames, 1)


def main() -> int:
    """Label, print, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path, help="folder with KITTI raw drives and their labels")
    parser.add_argument("--keep", type=Path, help="make the workspace here and keep it")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = on_kitti(arguments.keep or Path(temporary), arguments.root, [])
        upvl = str(Path(sys.executable).with_name("upvl"))
        subprocess.run(
            [upvl, "autolabel", "--moving-only"], cwd=folder, check=True, stdout=subprocess.DEVNULL
        )
        settings = load(EvalConfig, folder / "stages" / "eval.toml")
        in_view = gather(
            Workspace(PIPELINE, folder / "stages", folder / "out"), "nms", region=None
        ).without_classes()
    close = near(in_view)
    print_scores("front view", in_view, settings)
    print_scores(f"front view, up to {FAR_M:g} m", close, settings)
    passed = list(covered(close.labels, close.points, in_view.predictions, settings.moving_mps))
    false = false_boxes(close, settings.moving_mps)
    passed.append(false < MAX_FALSE)
    print(f"false moving boxes: {false:.2f} a frame (bar < {MAX_FALSE:g}) {'ok' if passed[-1] else 'MISSED'}")
    return 0 if all(passed) else 1


if __name__ == "__main__":
    raise SystemExit(main())
