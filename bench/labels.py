"""One table of labels for every drive and sensor preset, beside those of a plain script, in the same run.

    python bench/labels.py [--presets kitti twin32] [--drives kitti:ROOT parquet:ROOT] [--words] [--keep FOLDER]

By default all presets of the made-up city (with `clutter`), and the drives under ../shared/data where they are.
For each drive two modes: "moving" (`upvl autolabel --moving-only`) and "all" (all motion, no picture used); with
--words also "words" (all motion as shipped). A row of upvl, then one of the plain script (`plain_labels.py`):

- AP@0.4 and @0.5, class-agnostic, level 2, and MOTA at 0.4, as `upvl eval` prints them;
- of the moving labels with 30 points or more: the share found, and medians of those found (`box_errors.py`): length
  (box minus label), |length| where two sides face the car, bottom, across, heading, share of flips, |speed|,
  changes of id a track;
- on vehicles seen partly and fully: the 3D IoU that the whole box gains over the visible one.

Exits 1 where upvl's AP is below the plain script's, and prints the ratio. With --keep a second run makes only what
changed.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import plain_clusters
import plain_labels
from box_errors import BoxErrors, box_errors, gains
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.errors import BadInput
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material, gather, labelled_frames
from upvl_cli.evaluation.score import detection_scores, track_scores
from upvl_cli.metrics.waymo.inputs import Predictions
from upvl_cli.pipeline.presets import make_labels, preset_workspace
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import STAGES
from upvl_cli.stages.rows import GroundRow, OdometryRow, ProposalRow, TrackRow
from upvl_cli.synthetic.sensors import SENSORS
from upvl_cli.types import Boxes, TrackedBoxes, concat
from workspaces import ROOT, on_city, on_drives

DATA = ROOT.parent / "shared" / "data"
REAL = ("kitti:kitti_raw_a", "kitti:kitti_raw_b", "parquet:lyft")
OFF = {"extract-vl": {"images": '"none"'}, "pca": {"images": "0"}, "mask": {"unseen_policy": '"keep"'}}
MODES = {"moving": "moving-only", "all": "without-words", "words": ""}
COLUMNS = (
    f"{'drive':16} {'mode':7} {'of':5} {'AP@0.4':>7} {'AP@0.5':>7} {'MOTA':>6} {'found':>6} {'length':>7} "
    f"{'two':>5} {'bottom':>7} {'across':>7} {'head':>5} {'flips':>6} {'speed':>6} {'ids':>5} "
    f"{'partly':>7} {'fully':>6}"
)


@dataclass(frozen=True)
class Scores:
    """What is printed of one drive, mode and maker of labels."""

    ap: tuple[float, float]
    mota: float
    errors: BoxErrors
    partly: float = np.nan
    fully: float = np.nan


def workspaces(folder: Path, options: argparse.Namespace) -> dict[str, Path]:
    """Make the workspace of every drive; by name."""
    found = {}
    for name in options.presets:
        values = {"frames": options.frames, "train": 0, "val": options.val, "clutter": options.clutter}
        found[name] = on_city(folder / f"city-{name}", sensor=f'"{name}"', **values)
    for drive in options.drives:
        dataset, _, root = drive.partition(":")
        found[Path(root).name] = on_drives(folder / Path(root).name, dataset, Path(root), [])
    return found


def without_words(base: Workspace) -> Workspace:
    """Return the workspace of all motion in which no picture is used."""
    folder = base.stages / "presets" / MODES["all"]
    folder.mkdir(parents=True, exist_ok=True)
    for stage, values in OFF.items():
        (folder / f"{stage}.toml").write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
    return preset_workspace(base, folder.name)


def scores(material: Material, settings: EvalConfig, mode: str) -> Scores:
    """Score boxes as `upvl eval` does, and look at their errors."""
    moving = mode == "moving"
    found = detection_scores(material, settings, moving_only=moving)
    ap = {score.iou: score.ap[1] for score in found if score.objects == "all"}
    tracks = track_scores(material, replace(settings, iou=(0.4,)), moving_only=moving)
    mota = next(score.mota for score in tracks if score.level == 2)
    return Scores((ap[0.4], ap[0.5]), mota, box_errors(material, settings.moving_mps))


def visible_boxes(workspace: Workspace, segments: Sequence[str]) -> dict[tuple[str, int, str], Boxes]:
    """Return the proposal that each tracked box was made from, by segment, frame and track."""
    found = {}
    for segment in segments:
        proposals = workspace.table("propose", ProposalRow, segment)
        for row in workspace.table("track", TrackRow, segment):
            boxes = proposals[row.frame].boxes
            for track, place in zip(row.track_id.tolist(), row.proposal.tolist(), strict=True):
                if place >= 0:
                    found[segment, row.frame, str(track)] = boxes[[place]]
    return found


def plain(base: Workspace, segment: str, keep: Path) -> dict[str, dict[int, TrackedBoxes]]:
    """Return the plain script's boxes by mode and frame, from the file of an earlier run where nothing changed."""
    stamps = [base.shard_stamp(stage, segment) for stage in STAGES if stage.name in ("odometry", "ground")]
    source = "".join(Path(part.__file__).read_text() for part in (plain_labels, plain_clusters)) + str(
        plain_labels.pypatchworkpp is None
    )
    key = hashlib.sha256("".join([source, *stamps]).encode()).hexdigest()
    path = keep / f"plain-{segment}.pickle"
    if path.exists():
        known, boxes = pickle.loads(path.read_bytes())
        if known == key:
            return boxes
    poses = np.array([row.world_from_ego for row in base.table("odometry", OdometryRow, segment)])
    ground = {row.frame: row.is_ground for row in base.table("ground", GroundRow, segment)}
    started = time.process_time()
    boxes = plain_labels.labels(base.drive(segment), poses, ground)
    print(f"  plain script, {segment}: {time.process_time() - started:.0f} s of CPU", file=sys.stderr)
    path.write_bytes(pickle.dumps((key, boxes)))
    return boxes


def with_boxes(
    base: Workspace, material: Material, made: Mapping[str, Mapping[int, TrackedBoxes]]
) -> Material:
    """Return the material with other boxes, kept where objects were labelled, as `gather` does."""
    source, frames, _ = labelled_frames(base)
    parts = []
    for segment in material.segments:
        for frame in sorted(set(frames[segment].tolist()) & set(made[segment])):
            boxes = made[segment][frame]
            boxes = boxes[source.covers(segment, boxes.center_m)]
            count = len(boxes)
            zones = getattr(source, "unlabelled", None)
            parts.append(
                Predictions(
                    center_m=boxes.center_m,
                    size_lwh_m=boxes.size_lwh_m,
                    heading_rad=boxes.heading_rad,
                    sequence=np.full(count, segment),
                    frame=np.full(count, frame),
                    type=np.ones(count),
                    score=boxes.score,
                    velocity_mps=boxes.velocity_mps[:, :2],
                    object_id=boxes.track_id,
                    unlabelled=zones(segment, frame, boxes) if zones else np.zeros(count, bool),
                )
            )
    return replace(material, predictions=concat(parts, Predictions))


def drive_scores(folder: Path, modes: Sequence[str]) -> dict[tuple[str, str], Scores]:
    """Label the drives of a workspace in each mode; by mode and maker."""
    base = Workspace(PIPELINE, folder / "stages", folder / "out", "")
    _, labelled, left_out = labelled_frames(base)
    for segment, reason in left_out.items():
        print(f"  {segment} left out: {reason}", file=sys.stderr)
    settings = replace(load(EvalConfig, base.stages / "eval.toml"), iou=(0.4, 0.5))
    found: dict[tuple[str, str], Scores] = {}
    done: list[Workspace] = []
    for mode in modes:
        preset = MODES[mode]
        workspace = (
            without_words(base) if mode == "all" else preset_workspace(base, preset) if preset else base
        )
        started = time.process_time()
        for segment in labelled:
            for _ in make_labels(base, workspace, done, segment, lambda: None):
                pass
        print(f"  upvl, {mode}: {time.process_time() - started:.0f} s of CPU", file=sys.stderr)
        done.append(workspace)
        material = gather(workspace, "nms", region=None, segments=tuple(labelled)).without_classes()
        partly, fully, _ = gains(material, visible_boxes(workspace, material.segments))
        found[mode, "upvl"] = replace(scores(material, settings, mode), partly=partly, fully=fully)
        chosen = "moving" if mode == "moving" else "all"
        made = {segment: plain(base, segment, folder)[chosen] for segment in material.segments}
        found[mode, "plain"] = scores(with_boxes(base, material, made), settings, mode)
    return found


def print_row(drive: str, mode: str, maker: str, row: Scores) -> None:
    """Print one line of the table."""
    of = row.errors
    print(
        f"{drive:16} {mode:7} {maker:5} {row.ap[0]:7.3f} {row.ap[1]:7.3f} {row.mota:6.3f} {of.found:6.2f} "
        f"{of.length_m:+7.2f} {of.length_two_m:5.2f} {of.bottom_m:+7.2f} {of.across_m:+7.2f} {of.heading_deg:5.1f} "
        f"{of.flips:6.3f} {of.speed_mps:6.2f} {of.switches:5.2f} {row.partly:+7.2f} {row.fully:+6.2f}",
        flush=True,
    )


def arguments() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    there = [f"{kind}:{DATA / name}" for kind, _, name in (one.partition(":") for one in REAL)]
    there = [one for one in there if Path(one.partition(":")[2]).is_dir()]
    parser.add_argument("--presets", nargs="*", default=list(SENSORS), choices=list(SENSORS))
    parser.add_argument(
        "--drives", nargs="*", default=there, help="dataset:ROOT; only those with labels count"
    )
    parser.add_argument("--frames", type=int, default=20, help="sweeps of each drive of the city")
    parser.add_argument("--val", type=int, default=1, help="drives of the city")
    parser.add_argument("--clutter", type=float, default=1.0)
    parser.add_argument("--modes", nargs="+", default=["moving", "all"], choices=list(MODES))
    parser.add_argument("--words", action="store_true", help="also all motion with pictures")
    parser.add_argument("--keep", type=Path, help="make the workspaces here and keep them")
    options = parser.parse_args()
    if options.words and "words" not in options.modes:
        options.modes.append("words")
    return options


def main() -> int:
    """Print the table, and return the exit code."""
    options = arguments()
    if plain_labels.pypatchworkpp is None:
        print("pypatchworkpp is not installed: the plain script takes upvl's own ground")
    lost = []
    with tempfile.TemporaryDirectory() as temporary:
        print(COLUMNS)
        for drive, folder in workspaces(options.keep or Path(temporary), options).items():
            try:
                found = drive_scores(folder, options.modes)
            except BadInput as error:
                print(f"{drive:16} left out: {error}")
                continue
            for (mode, maker), row in found.items():
                print_row(drive, mode, maker, row)
            for mode in options.modes:
                ratios = np.array(found[mode, "upvl"].ap) / np.maximum(found[mode, "plain"].ap, 1e-9)
                print(f"{drive:16} {mode:7} ratio {ratios[0]:7.2f} {ratios[1]:7.2f}", flush=True)
                if (ratios < 1).any():
                    lost.append(f"{drive} {mode}")
    if lost:
        print(f"below the plain script: {', '.join(lost)}")
    return int(bool(lost))


if __name__ == "__main__":
    raise SystemExit(main())
