"""What words are worth to labels in all motion states: python bench/all_motion.py [--keep FOLDER] [--kitti ROOT].

Labels drives of the city's split val, or KITTI raw drives with labels, as shipped, with words switched off, and
with other values of r_bg and eps_bg.
Prints class-agnostic AP (level 2) of all objects and of those that stand, and mAP by name, in percent.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material, gather
from upvl_cli.evaluation.score import detection_scores, named_scores
from upvl_cli.metrics.waymo.inputs import speed_mps
from upvl_cli.pipeline.presets import make_labels, preset_workspace
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.vlm.mini import OBJECTS
from workspaces import on_city, on_kitti

OFF = {"extract-vl": {"images": '"none"'}, "pca": {"images": "0"}, "mask": {"unseen_policy": '"keep"'}}
MOVING = {
    **OFF,
    "mask": {"unseen_policy": '"keep"', "min_speed_mps": "1.0"},
    "propose": {"clustering.eps_m": "[1.0]", "clustering.scale_with_range": "false"},
    "track": {"travel.required": "true"},
}
RUNS: dict[str, Mapping[str, Mapping[str, str]]] = {
    "as shipped": {},
    "words off": OFF,
    **{
        f"without a view: {policy}": {"mask": {"unseen_policy": f'"{policy}"'}}
        for policy in ("keep", "moving", "place_memory")
    },
    "moving only": MOVING,
    "background clusters too": {"propose": {"background.cluster": "true"}},
    "features in the distance": {"propose": {"clustering.use_vl": "true"}},
    **{
        f"r_bg {share} %": {
            "propose": {"background.max_share": f"{share / 100}"},
            "amodal": {"max_background_share": f"{share / 100}"},
        }
        for share in (10, 25, 50, 75, 90, 99, 100)
    },
    **{
        f"eps_bg {eps}": {
            "mask": {"use_model_rule": "false", "eps_bg": str(eps), "against": json.dumps(OBJECTS)}
        }
        for eps in (-0.4, -0.2, 0.0, 0.08, 0.2, 0.4, 0.6)
    },
}


def main() -> None:
    """Run, score, print; exits 1 where words do not double the AP of all objects."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--drives", type=int, default=2)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--kitti", type=Path, help="folder with KITTI raw drives, in place of the city")
    parser.add_argument("--only", nargs="+", default=list(RUNS), help="names of runs")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        if options.kitti:
            on_kitti(folder, options.kitti, [])
        else:
            on_city(folder, frames=options.frames, train=0, val=options.drives)
        base = Workspace(PIPELINE, folder / "stages", folder / "out", "")
        done: list[Workspace] = []
        ap = {}
        print(f"{'':26} AP@0.4  AP@0.5  standing@0.4  mAP by name (vehicles, VRU)")
        for name in options.only:
            workspace = _preset(base, name)
            for segment in base.segments:
                for _ in make_labels(base, workspace, done, segment, lambda: None):
                    pass
            done.append(workspace)
            ap[name] = _scores(workspace, name)
        if {"as shipped", "words off"} <= set(ap):
            ratio = ap["as shipped"] / max(ap["words off"], 1e-9)
            print(f"words make {ratio:.2f} times the AP@0.4 of all objects (bar 2)")
            sys.exit(ratio < 2)


def _preset(base: Workspace, name: str) -> Workspace:
    if not RUNS[name]:
        return base
    folder = base.stages / "presets" / name.replace(" ", "-").replace("%", "percent")
    folder.mkdir(parents=True, exist_ok=True)
    for stage, values in RUNS[name].items():
        (folder / f"{stage}.toml").write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
    return preset_workspace(base, folder.name)


def _scores(workspace: Workspace, name: str) -> float:
    """Print a line; returns AP@0.4 of all objects."""
    settings = replace(
        load(EvalConfig, workspace.stages / "eval.toml"), iou=(0.4, 0.5), range_edges_m=(30.0,)
    )
    named = gather(workspace, "nms", region=None, named=True)
    material = named.without_classes()
    scores = detection_scores(material, settings, moving_only=False)
    both = [score.ap[1] for score in scores if score.objects == "all"]
    standing = detection_scores(_standing(material, settings.moving_mps), settings, moving_only=False)[0].ap[
        1
    ]
    vehicles, vru, mean = named_scores(named, iou=0.4, moving_mps=None)
    figures = [100 * value for value in (*both, standing, mean, vehicles, vru)]
    print("{:26} {:6.1f}  {:6.1f}  {:12.1f}  {:6.1f} ({:.1f}, {:.1f})".format(name, *figures), flush=True)
    return both[0]


def _standing(material: Material, moving_mps: float) -> Material:
    """Return the labels that are static, and the boxes that are."""
    labels, boxes = (
        speed_mps(boxes.velocity_mps) < moving_mps for boxes in (material.labels, material.predictions)
    )
    return replace(
        material,
        labels=material.labels[labels],
        points=material.points[labels],
        in_view=material.in_view[labels],
        predictions=material.predictions[np.asarray(boxes)],
    )


if __name__ == "__main__":
    main()
