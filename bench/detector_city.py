"""What a detector learns from auto labels of the built-in city: python bench/detector_city.py [--keep FOLDER].

Labels drives of train and of val in all motion states, learns from those of train alone as the preset `small`
does, and scores labels and detections of val against the truth, 100 x 40 m around the car, level 2, in percent:
with distillation and without (then words come from the pictures), for each seed. Then asks val for kinds by
words, fire truck and tram among them, which no drive of train has. With --moving-only labels and scores are of
what moves, whatever its class, without a picture (only the column for moving objects counts then). Detections are
asked in more drives of val than are labelled, as they need no picture: kinds that are new are rare.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import gather
from upvl_cli.evaluation.region import Region
from upvl_cli.evaluation.score import detection_scores, named_scores
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import classes_from_phrases
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import find
from upvl_cli.query.kinds import with_kinds
from upvl_cli.query.run import query_config
from upvl_cli.query.store import open_store
from upvl_cli.query.vocabulary import build_vocabulary
from upvl_cli.types import Boxes
from workspaces import on_city

AROUND = Region(100.0, 40.0)
ASKED = ("vehicle", "car", "person", "bus", "truck", "fire truck", "tram")
FOUND_IOU = 0.1  # a hit that overlaps less is another thing


def main() -> None:
    """Make, learn, score, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--train", type=int, default=10)
    parser.add_argument("--val", type=int, default=2)
    parser.add_argument("--asked", type=int, default=12, help="drives of val to ask detections in")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--steps", type=int, help="instead of those of the preset")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument(
        "--distillation",
        type=float,
        nargs="+",
        default=[0.0, 1.0],
        help="weights, 0 for none; the last is asked",
    )
    parser.add_argument("--moving-only", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        asked = options.val if options.moving_only else max(options.asked, options.val)
        folder = on_city(options.keep or Path(scratch), frames=options.frames, train=options.train, val=asked)
        train = [f"train-{number:03d}" for number in range(options.train)]
        val = [f"val-{number:03d}" for number in range(asked)]
        scored, more = val[: options.val], val[options.val :]
        _upvl(
            folder, ["autolabel", "--moving-only" if options.moving_only else "--all-motion"], train + scored
        )
        print(f"{'':28} AP@0.4  AP@0.5  moving@0.4  mAP@0.4 by name (vehicles, VRU)")
        _scored(folder, scored, "auto labels", "nms")
        for seed in options.seeds:
            for weight in [0.0] if options.moving_only else options.distillation:
                _train(folder, options.steps, weight, seed)
                _upvl(folder, ["detect"], scored)
                _scored(folder, scored, f"detector, distillation {weight:g}, seed {seed}", "detect")
        if not options.moving_only:
            for stage in ("odometry", "ground", "detect") if more else ():
                _upvl(folder, [stage], more)
            for on, drives in (("labels", scored), ("detections", val)):
                for by in ("vote", "mean"):
                    _asked(folder, drives, on, by)


def _upvl(folder: Path, arguments: list[str], segments: list[str]) -> None:
    chosen = [f"--segment={name}" for name in segments]
    command = [Path(sys.executable).with_name("upvl"), *arguments, *chosen]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


def _train(folder: Path, steps: int | None, weight: float, seed: int) -> None:
    presets = folder / "stages" / "presets"
    small = tomllib.loads((presets / "small" / "train.toml").read_text())
    if steps:
        small |= {"steps": steps, "check_steps": max(steps // 6, 1)}
    lines = ['drives = ["train-*"]', f"seed = {seed}", *(f"{key} = {value}" for key, value in small.items())]
    lines += ["[distillation]", "enabled = " + ("true" if weight else "false")]
    lines += [f"weight = {weight}"] if weight else []
    (presets / "bench").mkdir(exist_ok=True)
    (presets / "bench" / "train.toml").write_text("\n".join(lines) + "\n")
    _upvl(folder, ["train", "--preset", "bench"], [])


def _scored(folder: Path, drives: list[str], name: str, stage: str) -> None:
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    settings = replace(
        load(EvalConfig, workspace.stages / "eval.toml"), iou=(0.4, 0.5), range_edges_m=(30.0,)
    )
    named = gather(workspace, stage, region=AROUND, named=True, segments=drives)
    agnostic = named.without_classes()
    whole = [
        of.ap[1] for of in detection_scores(agnostic, settings, moving_only=False) if of.objects == "all"
    ]
    moving = detection_scores(agnostic, settings, moving_only=True)[0].ap[1]
    vehicles, vru, mean = named_scores(named, iou=0.4, moving_mps=None)
    figures = [100 * value for value in (*whole, moving, mean, vehicles, vru)]
    print("{:28} {:6.1f}  {:6.1f}  {:10.1f}  {:7.1f} ({:.1f}, {:.1f})".format(name, *figures), flush=True)


def _asked(folder: Path, drives: list[str], on: str, by: str) -> None:
    """Print, for each phrase, how many things of that kind its hits find, and how many hits are on nothing of it.

    Args:
        folder: The workspace.
        drives: Those to ask.
        on: "labels" or "detections".
        by: Whether the points of a box vote, or its mean feature is asked: an ablation of the paper.
    """
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    config = query_config(workspace, {"by": by})
    source = label_source(workspace.raw.dataset, Path(workspace.raw.root), workspace.dataset)
    labels = {name: source.labels(name) for name in drives}
    print(f"asked of {on}, by {by}: boxes of the kind with 6 points or more found, and hits on another thing")
    for phrase in ASKED:
        classes = with_kinds(classes_from_phrases([phrase]), workspace.settings(PIPELINE.by_name["classify"]))
        vocabulary = build_vocabulary(workspace, classes, config, check_spelling=True)
        hits = find(open_store(workspace, on), vocabulary, Filters(segments=drives), config).hits
        wanted = found = right = 0
        for name in drives:
            truth = labels[name]
            kind = _is(phrase, truth)
            is_kind = kind & (truth.num_points >= 6) & AROUND.contains(truth.center_m)
            for frame in np.unique(truth.frame):
                asked = truth[is_kind & (truth.frame == frame)]
                here = hits[(hits.segment == name) & (hits.frame == frame)]
                boxes = Boxes(here.center_m, here.size_lwh_m, here.heading_rad)
                overlap = iou_bev(asked, boxes) > FOUND_IOU
                wanted += len(asked)
                found += int(overlap.any(axis=1).sum())
                # A hit is right on anything of the kind, also far away and with few points.
                every = truth[kind & (truth.frame == frame)]
                right += int((iou_bev(every, boxes) > FOUND_IOU).any(axis=0).sum())
        print(
            f"  {phrase:12} {found:5} of {wanted:5} found; {len(hits) - right:5} of {len(hits):5} hits false"
        )


def _is(phrase: str, truth) -> np.ndarray:
    """(n,) which labels the phrase is right for."""
    by_type = {"vehicle": (1,), "person": (2,)}
    if phrase in by_type:
        return np.isin(truth.type, by_type[phrase])
    kinds = {"car": ("sedan", "hatchback", "suv", "taxi", "police car")}.get(phrase)
    if kinds:
        return np.isin(truth.class_name, kinds)
    return np.array([phrase in kind for kind in truth.class_name], dtype=np.bool_)


if __name__ == "__main__":
    main()
