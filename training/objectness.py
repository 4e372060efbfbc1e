"""Fit the objectness prior that ships with the package: python training/objectness.py [--keep FOLDER] [--check].

Labels drives of the made-up city (all motion, no picture used) under several sensor presets, with banks, hedges,
bushes, fences and car parks, up to the fit of boxes. A track is a road user as far as its boxes overlap a true one
(3D IoU 0.4, of small ones 0.15): gradient-boosted trees learn that share from the shape, size and motion of the
track. Presets in KEPT_OUT are never fitted to; they are scored at the end, beside those that were.

Writes src/upvl_cli/perception/objectness/prior.safetensors. `--check` fits without writing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import average_precision_score, log_loss

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.geometry.boxes import transform
from upvl_cli.geometry.iou import iou_3d
from upvl_cli.geometry.se3 import inverse
from upvl_cli.perception.objectness.prior import FILE
from upvl_cli.perception.objectness.track_features import FEATURES
from upvl_cli.perception.objectness.trees import Forest
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.presets import make_labels, preset_workspace
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import STAGES, amodal
from upvl_cli.stages.track_sightings import PendingFrame
from upvl_cli.types import Boxes

ROOT = Path(__file__).parents[1]
CODE = ROOT / "src" / "upvl_cli" / "perception" / "objectness"
BOX_STAGES = ("ground", "flow", "mask", "propose", "track", "amodal")
PRESETS = ("kitti", "twin32", "waymo", "beams40", "lyft_5hz", "hdl32_20hz", "hdl32_2hz")
KEPT_OUT = ("beams16", "solid_state")
SEEDS = (11,)
FRAMES = 30
IOU = 0.4
# A box of a person or a rider misses that by a hand's breadth, and is one for all that.
SMALL_M, SMALL_IOU = 2.6, 0.15
# The sign is clear: a wall goes on beside the box, a bush is scattered, what was seen for long is there.
FALLING = ("ring_ratio", "scatter")
RISING = ("seconds", "seen_share")


def fitted_to() -> str:
    """Return a digest of all that decides which boxes there are and what is measured on them.

    It covers the versions and the values of the stages that make boxes, and the code of the features.
    """
    of_boxes = [stage for stage in STAGES if stage.name in BOX_STAGES]
    values = {
        stage.name: [stage.version, load(stage.config, ROOT / "stages" / f"{stage.name}.toml").values()]
        for stage in of_boxes
    }
    source = [(CODE / f"{name}.py").read_text() for name in ("ring", "shape", "track_features")]
    return hashlib.sha256(json.dumps([values, source], sort_keys=True).encode()).hexdigest()


class Examples(NamedTuple):
    """Tracks of one drive.

    Attributes:
        features: (n, f) features of each.
        share: (n,) share of its boxes that are right.
        frames: (n,) its frames.
    """

    features: np.ndarray
    share: np.ndarray
    frames: np.ndarray


def examples(workspace: Workspace, segment: str) -> Examples:
    """Return the tracks of a drive whose stages up to `track` are made."""
    stage, settings = amodal.STAGE, workspace.settings(amodal.STAGE)
    inputs = ShardInputs(workspace, stage, segment, settings)
    labels = label_source(workspace.raw.dataset, Path(workspace.raw.root), workspace.dataset).labels(segment)
    truth = {int(frame): labels[labels.frame == frame] for frame in np.unique(labels.frame)}
    pending: deque[PendingFrame] = deque()
    found = []
    for fitted in amodal.fitted_parts(inputs, amodal.track_totals(inputs), settings, pending):
        if fitted is not None:
            right = list(_is_right(fitted, truth))
            found.append((fitted.features, np.mean(right), len(right)))
        pending.clear()
    features, share, frames = zip(*found, strict=True)
    return Examples(np.array(features), np.array(share), np.array(frames))


def _is_right(fitted: amodal.FittedPart, truth: dict[int, Boxes]) -> Iterator[bool]:
    """Yield whether each box of a track overlaps a true one."""
    for sighting, row in zip(fitted.part.sightings, fitted.rows, strict=True):
        labels = truth.get(int(sighting.frame.tracks.frame))
        if labels is None or not len(labels):
            yield False
            continue
        box = transform(Boxes.from_rows(row[None]), inverse(sighting.frame.pose.world_from_ego))
        near = np.linalg.norm(labels.center_m[:, :2] - box.center_m[0, :2], axis=1) < 15
        boxes = Boxes(labels.center_m[near], labels.size_lwh_m[near], labels.heading_rad[near])
        least = np.where(boxes.size_lwh_m[:, 0] < SMALL_M, SMALL_IOU, IOU)
        yield bool((iou_3d(box, boxes)[0] >= least).any())


def fit(drives: list[Examples]) -> HistGradientBoostingClassifier:
    """Return the trees: each track counts once as right and once as wrong, by its share of right boxes."""
    features = np.concatenate([drive.features for drive in drives])
    share = np.concatenate([drive.share for drive in drives])
    # Every drive counts alike; a long track has more boxes at stake, but they are one object.
    roots = [np.sqrt(drive.frames) for drive in drives]
    weight = np.concatenate([root / root.sum() * len(features) / len(drives) for root in roots])
    signs = [-1 if name in FALLING else 1 if name in RISING else 0 for name in FEATURES]
    trees = HistGradientBoostingClassifier(
        learning_rate=0.06,
        max_iter=300,
        max_leaf_nodes=8,
        min_samples_leaf=30,
        l2_regularization=20.0,
        monotonic_cst=signs,
        random_state=0,
    )
    both = np.concatenate([np.ones(len(share)), np.zeros(len(share))])
    return trees.fit(
        np.concatenate([features, features]),
        both,
        sample_weight=np.concatenate([weight * share, weight * (1 - share)]),
    )


def to_forest(trees: HistGradientBoostingClassifier) -> Forest:
    """Return the same trees as arrays."""
    columns: dict[str, list[np.ndarray]] = {
        name: [] for name in ("feature", "threshold", "left", "right", "nan", "value")
    }
    roots, total = [], 0
    for (
        predictor,
    ) in trees._predictors:  # scikit-learn keeps the nodes there, and gives no other way to them
        nodes = predictor.nodes
        own = np.arange(len(nodes)) + total
        leaf = nodes["is_leaf"].astype(bool)
        columns["feature"].append(np.where(leaf, -1, nodes["feature_idx"]).astype(np.int16))
        columns["threshold"].append(np.where(leaf, 0.0, nodes["num_threshold"]))
        columns["left"].append(np.where(leaf, own, nodes["left"] + total).astype(np.int32))
        columns["right"].append(np.where(leaf, own, nodes["right"] + total).astype(np.int32))
        columns["nan"].append(nodes["missing_go_to_left"].astype(np.uint8))
        columns["value"].append(np.where(leaf, nodes["value"], 0.0))
        roots.append(total)
        total += len(nodes)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Forest(
        joined["feature"],
        joined["threshold"],
        joined["left"],
        joined["right"],
        joined["nan"],
        joined["value"],
        np.array(roots, np.int32),
        np.array(trees._baseline_prediction, np.float64).reshape(1),
        FEATURES,
        fitted_to(),
    )


def drive_of(folder: Path, sensor: str, seed: int) -> Workspace:
    """Return the workspace of a city drive whose labels are made as far as `track`."""
    sys.path.insert(0, str(ROOT / "bench"))
    from workspaces import on_city

    on_city(folder, frames=FRAMES, train=1, val=0, seed=seed, sensor=f'"{sensor}"', clutter=1.0)
    base = Workspace(PIPELINE, folder / "stages", folder / "out", "")
    workspace = preset_workspace(base, "without-words")
    for segment in base.segments:
        for made in make_labels(base, workspace, [], segment, lambda: None):
            if made.stage == "track":
                break
    return workspace


def main() -> None:
    """Fit, score, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--keep", type=Path, help="keep the drives here; a second run makes only what changed"
    )
    parser.add_argument("--check", action="store_true", help="fit and score, and write nothing")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        found: dict[str, Examples] = {}
        for sensor in (*PRESETS, *KEPT_OUT):
            for seed in SEEDS if sensor in PRESETS else SEEDS[:1]:
                workspace = drive_of(folder / f"{sensor}-{seed}", sensor, seed)
                (segment,) = workspace.segments
                found[f"{sensor}-{seed}"] = drive = examples(workspace, segment)
                print(
                    f"{sensor}-{seed}: {len(drive.share)} tracks, {(drive.share > 0.5).sum()} right",
                    flush=True,
                )
    used = [name for name in found if name.rsplit("-", 1)[0] in PRESETS]
    print(f"{'drive':16} {'tracks':>7} {'AP':>6} {'base':>6} {'log loss':>9}  (each left out of its own fit)")
    for name, drive in found.items():
        sensor = name.rsplit("-", 1)[0]
        others = [found[other] for other in used if not other.startswith(f"{sensor}-")]
        forest = to_forest(fit(others))
        chance = forest.probability(drive.features)
        right = drive.share > 0.5
        print(
            f"{name:16} {len(right):7} {average_precision_score(right, chance, sample_weight=drive.frames):6.3f} "
            f"{np.average(right, weights=drive.frames):6.3f} {log_loss(right, chance, sample_weight=drive.frames):9.3f}"
        )
    if not options.check:
        target = CODE / FILE
        target.write_bytes(to_forest(fit([found[name] for name in used])).to_bytes())
        print(f"wrote {target}")


if __name__ == "__main__":
    main()
