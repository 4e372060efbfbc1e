"""Measure how well words find what points show, on city drives of the split val: python bench/vl_city.py [--keep DIR].

Prints the share of seen points in their true group (vehicle, VRU, background), and the share whose nearest word
among all kinds is their own, for kinds that the model was trained on and for those that it has never seen.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.synthetic.kind import CYCLIST, PEDESTRIAN, VEHICLE
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.piece import STUFF
from workspaces import make, on_city

GROUPS = ("vehicle", "VRU", "background")


def group_of(name: str) -> int:
    """Which group a name of the city belongs to; -1 for a thing that is in none (a dog, a cone)."""
    if name in STUFF and name not in KINDS:
        return 2
    kind = KINDS[name].type
    return {VEHICLE: 0, PEDESTRIAN: 1, CYCLIST: 1}.get(kind, -1)


def main() -> None:
    """Label, compare, print; exits 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--drives", type=int, default=3)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = on_city(options.keep or Path(scratch), frames=options.frames, train=0, val=options.drives)
        make(folder, "odometry", "ground", "flow", "pca", "extract-vl")
        workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
        sys.exit(not scored(workspace))


def scored(workspace: Workspace) -> bool:
    """Print the scores; whether the bar is met."""
    names = workspace.settings(PIPELINE.by_name["classify"])
    background = workspace.settings(PIPELINE.by_name["mask"]).background
    lists = (names.vehicle, (*names.pedestrian, *names.cyclist), (*background, *names.other))
    group_words = workspace.model.embed_text([word for words in lists for word in words])
    group_of_word = np.repeat(np.arange(3), [len(words) for words in lists])
    kinds = list(dict.fromkeys([*KINDS, *STUFF]))
    kind_words = workspace.model.embed_text(kinds)
    (pca,) = workspace.table("pca", PcaRow)
    confusion = np.zeros((3, 3), dtype=np.int64)
    hits, total = np.zeros(len(kinds)), np.zeros(len(kinds))
    for segment in workspace.segments:
        drive = workspace.drive(segment)
        scene = np.array(drive.scene.names)
        for row in workspace.table("extract-vl", ExtractVlRow, segment):
            _, truth = drive.points_with_truth(row.frame)
            group = np.array([group_of(name) for name in scene])[truth.name[row.state == SEEN]]
            found = group_of_word[pca.basis.cosines(row.feature, group_words).argmax(axis=1)]
            known = group >= 0
            np.add.at(confusion, (group[known], found[known]), 1)
            best = pca.basis.cosines(row.feature, kind_words).argmax(axis=1)
            true = np.array([kinds.index(name) for name in scene])[truth.name[row.state == SEEN]]
            hits += np.bincount(true[best == true], minlength=len(kinds))
            total += np.bincount(true, minlength=len(kinds))
    right = np.diag(confusion).sum() / confusion.sum()
    for place, group_name in enumerate(GROUPS):
        row_shares = confusion[place] / max(confusion[place].sum(), 1)
        print(
            f"{group_name:10} {confusion[place].sum():8d} points: "
            + "  ".join(f"{n} {s:.3f}" for n, s in zip(GROUPS, row_shares, strict=True))
        )
    print(f"{right:.3f} of the seen points in their group (bar 0.85)")
    novel = set(workspace.dataset.settings.held_out)
    for what, chosen in (("trained on", [k for k in KINDS if k not in novel]), ("never seen", sorted(novel))):
        places = [kinds.index(kind) for kind in chosen if total[kinds.index(kind)] > 0]
        shares = [hits[place] / total[place] for place in places]
        mean = np.mean(shares) if shares else float("nan")
        print(f"top-1 among {len(kinds)} words, {len(places)} kinds {what}: mean {mean:.3f}")
        for place, share in sorted(zip(places, shares, strict=True), key=lambda item: -item[1]):
            print(f"  {kinds[place]:22} {share:.3f} of {int(total[place])}")
    return bool(right >= 0.85)


if __name__ == "__main__":
    main()
