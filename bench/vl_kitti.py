"""Do words tell vehicles from background on real points: python bench/vl_kitti.py ../shared/data/kitti_raw_a.

Of the points inside labelled vehicles that a camera sees, how many are closer to a vehicle word than to any word
for background; of those on the ground or more than 4 m above it, how many the opposite.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import GroundRow
from workspaces import make, on_kitti

VEHICLE = 1
HIGH_M = 4.0


def main() -> None:
    """Extract, compare, print; exits 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = on_kitti(options.keep or Path(scratch), options.root, [])
        make(folder, "odometry", "ground", "flow", "pca", "extract-vl")
        workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
        (segment,) = workspace.segments
        sys.exit(not scored(workspace, segment))


def scored(workspace: Workspace, segment: str) -> bool:
    """Print both shares; whether both bars are met."""
    vehicle = workspace.settings(PIPELINE.by_name["classify"]).vehicle
    background = workspace.settings(PIPELINE.by_name["mask"]).background
    words = workspace.model.embed_text([*vehicle, *background])
    (pca,) = workspace.table("pca", PcaRow)
    source = label_source(workspace.raw.dataset, Path(workspace.raw.root), workspace.dataset)
    labels, frames = source.labels(segment), source.frames(segment)
    features, ground = (
        workspace.table("extract-vl", ExtractVlRow, segment),
        workspace.table("ground", GroundRow, segment),
    )
    vehicles, rest = np.zeros(2), np.zeros(2)
    for frame in frames.tolist():
        row, floor = features[frame], ground[frame]
        seen = row.state == SEEN
        cosines = pca.basis.cosines(row.feature, words)
        is_vehicle = cosines[:, : len(vehicle)].max(axis=1) > cosines[:, len(vehicle) :].max(axis=1)
        boxes = labels[(labels.frame == frame) & (labels.type == VEHICLE)]
        xyz = workspace.drive(segment).points(frame).xyz_ego_m[seen]
        inside = points_inside(xyz, boxes, margin_m=0.0).any(axis=0) & ~floor.is_ground[seen]
        other = (floor.is_ground[seen] | (floor.height_m[seen] > HIGH_M)) & ~points_inside(
            xyz, boxes, margin_m=0.3
        ).any(axis=0)
        vehicles += is_vehicle[inside].sum(), inside.sum()
        rest += (~is_vehicle[other]).sum(), other.sum()
        print(
            f"frame {frame}: in vehicles {is_vehicle[inside].mean():.3f}, elsewhere {(~is_vehicle[other]).mean():.3f}"
        )
    shares = vehicles[0] / vehicles[1], rest[0] / rest[1]
    print(
        f"in vehicles {shares[0]:.3f} (bar 0.80), on the ground or above {HIGH_M:.0f} m {shares[1]:.3f} (bar 0.90)"
    )
    return bool(shares[0] >= 0.80 and shares[1] >= 0.90)


if __name__ == "__main__":
    main()
