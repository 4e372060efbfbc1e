"""The paper's tables filled on the drives of a workspace, beside the published figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Protocol

from rich.table import Table

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material, gather, labelled_frames
from upvl_cli.evaluation.paper import COLUMNS, TABLES, PaperRow, PaperTable, Score
from upvl_cli.evaluation.run import STAGE_OF
from upvl_cli.evaluation.score import detection_scores, named_scores, track_scores
from upvl_cli.pipeline.presets import make_detector, make_labels, preset_workspace
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed
from upvl_cli.stages import LABELLING, STAGES, train

_IOUS = (0.4, 0.5)  # 3D IoU of the paper's Table 1; the other tables are at the first
_NOTE = "published: Waymo Open Dataset; ours: the drives of this workspace. Not the same data."
_NAMED_NOTE = f"{_NOTE} Ours is AP@0.4 L2."
_TRACK_NOTE = f"{_NOTE} Ours is at IoU 0.4 L2, whatever the class; of MOTP lower is better."
_NOTES: dict[Score, str] = {"class-agnostic": _NOTE, "named": _NAMED_NOTE, "tracking": _TRACK_NOTE}


@dataclass(frozen=True)
class FilledRow:
    """One row of a table with our figures.

    Attributes:
        row: The published row.
        ours: Our figure of each column in percent; NaN where there is none.
        missing: Reason why the row could not be filled; empty where it was.
    """

    row: PaperRow
    ours: tuple[float, ...]
    missing: str


def missing(row: PaperRow, folder: Path, *, detectors: bool) -> str:
    """Return the first thing that a row lacks, in words; empty where the row can be filled.

    Args:
        row: The published row.
        folder: Folder of the presets.
        detectors: Whether detectors are trained for their rows.
    """
    names = [stage.name for stage in STAGES]
    made_here = names if detectors else LABELLING
    stage = next((name for name in row.needs if name not in made_here), None)
    if stage in names:
        return "with --detectors"
    if stage:
        return f"no {stage} yet"
    if row.preset and not (folder / row.preset).is_dir():
        return f"no preset {row.preset} yet"
    return ""


def presets(workspace: Workspace, *, detectors: bool) -> dict[str, bool]:
    """Return the presets that can be made, in the order of the tables, each with whether a row scores its detector.

    The name "" stands for the values that ship.

    Args:
        workspace: The workspace with the folder of presets.
        detectors: Whether detectors are trained for their rows.
    """
    folder = workspace.stages / "presets"
    found: dict[str, bool] = {}
    for row in (row for table in TABLES for row in table.rows):
        if not missing(row, folder, detectors=detectors):
            found[row.preset] = found.get(row.preset, False) or row.what == "detections"
    return found


def scored_drives(workspace: Workspace, *, detectors: bool) -> list[str]:
    """Return the drives to score in: those with labels, less those that a detector is trained on.

    Args:
        workspace: The workspace of the drives.
        detectors: Whether detectors are trained for their rows; all rows are scored in the same drives.

    Raises:
        BadInput: No drive has labels.
        BadSetting: The detectors would learn from all of those.
    """
    labelled = list(labelled_frames(workspace)[1])
    training = workspace.drives_of(train.STAGE) if detectors else ()
    scored = [name for name in labelled if name not in training]
    if not scored:
        raise BadSetting(
            f"the detectors would learn from every drive that has labels; expected some to score in: set drives in "
            f'{workspace.stages / "train.toml"}, such as drives = ["train-*"]'
        )
    return scored


def shards(workspace: Workspace, *, detectors: bool) -> int:
    """Return the number of shards that `fill` makes or finds; see `fill`."""
    made, drives = presets(workspace, detectors=detectors), scored_drives(workspace, detectors=detectors)
    return len(made) * len(LABELLING) * len(workspace.segments) + sum(made.values()) * (1 + len(drives))


class Watcher(Protocol):
    """What displays the progress of making shards."""

    def tick(self) -> None:
        """Count one more frame."""

    def done(self, made: Made) -> None:
        """Count one more shard."""


def fill(
    workspace: Workspace, watcher: Watcher, *, detectors: bool
) -> Iterator[tuple[PaperTable, list[FilledRow]]]:
    """Make the shards that the rows need, and yield each table with its filled rows.

    Args:
        workspace: The workspace that the presets differ from.
        watcher: Display of the progress.
        detectors: Whether to train detectors for the rows that score one.

    Raises:
        BadInput: No drive has labels.
        BadSetting: A preset or a value is wrong, or detectors leave no drive to score.
    """
    settings = replace(load(EvalConfig, workspace.stages / "eval.toml"), iou=_IOUS)
    drives = scored_drives(workspace, detectors=detectors)  # first: without any, making shards is in vain
    made: dict[str, Workspace] = {}
    for name, has_detector in presets(workspace, detectors=detectors).items():
        chosen = made[name] = preset_workspace(workspace, name) if name else workspace
        lenders = [lender for lender in made.values() if lender not in (workspace, chosen)]
        for segment in workspace.segments:
            for shard in make_labels(workspace, chosen, lenders, segment, watcher.tick):
                watcher.done(shard)
        for shard in make_detector(workspace, chosen, lenders, drives, watcher.tick) if has_detector else ():
            watcher.done(shard)

    @cache
    def gathered(preset: str, stage: str) -> Material:
        return gather(made[preset], stage, region=None, named=True, segments=drives)

    for table in TABLES:
        rows = []
        for row in table.rows:
            reason = missing(row, workspace.stages / "presets", detectors=detectors)
            material = None if reason else gathered(row.preset, STAGE_OF[row.what])
            rows.append(_fill_row(table, row, material, reason, settings))
        yield table, rows


def _fill_row(
    table: PaperTable, row: PaperRow, material: Material | None, reason: str, settings: EvalConfig
) -> FilledRow:
    if material is None:
        return FilledRow(row, (math.nan,) * len(COLUMNS[table.score]), reason)
    ours = _score_row(material, table, row, settings)
    return FilledRow(row, tuple(100 * value for value in ours), "")


def _score_row(
    material: Material, table: PaperTable, row: PaperRow, settings: EvalConfig
) -> tuple[float, ...]:
    objects = material.without_classes()
    moving_only = table.moving_only
    if table.score == "tracking":
        # A detection without a track has no identity to score.
        tracked = objects.predictions[objects.predictions.object_id != "-1"]
        objects = replace(objects, predictions=tracked)
        level_2 = track_scores(objects, settings, moving_only=moving_only)[1]
        # Without a cut-off of positive MOTA the tool reports 0 for both, but a MOTP of 0 would be a perfect one.
        return level_2.mota, level_2.motp if level_2.cutoff is not None else math.nan
    if table.score == "named" and row.needs:
        moving_mps = settings.moving_mps if moving_only else None
        return named_scores(material, iou=_IOUS[0], moving_mps=moving_mps)
    scores = detection_scores(objects, settings, moving_only=moving_only)
    overall = [score for score in scores if score.objects == "all"]
    if table.score == "named":  # a row without names
        return math.nan, math.nan, overall[0].ap[1]
    return tuple(ap for score in overall for ap in score.ap)


def render(table: PaperTable, rows: Sequence[FilledRow]) -> Table:
    """Return a table for the terminal: each row with the published figures, and below it ours where there are some."""
    out = Table(title=table.title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    out.caption, out.caption_justify = _NOTES[table.score], "left"
    out.add_column("published", no_wrap=True)
    for name in COLUMNS[table.score]:
        out.add_column(name, justify="right", no_wrap=True)
    out.add_column("")
    for filled in rows:
        out.add_row(filled.row.name, *map(_percent, filled.row.published), filled.missing)
        if not filled.missing:
            out.add_row("  ours", *map(_percent, filled.ours), "")
    return out


def write(workspace: Workspace, tables: Sequence[tuple[PaperTable, Sequence[FilledRow]]]) -> Path:
    """Write all tables to `out/eval/tables.json` and return its path."""
    content = [
        {
            "title": table.title,
            "columns": list(COLUMNS[table.score]),
            "note": _NOTES[table.score],
            "rows": [
                {
                    "name": filled.row.name,
                    "preset": filled.row.preset,
                    "published": _plain(filled.row.published),
                    "ours": _plain(filled.ours),
                    "missing": filled.missing,
                }
                for filled in rows
            ],
        }
        for table, rows in tables
    ]
    path = workspace.out / "eval" / "tables.json"
    write_if_changed(path, json.dumps(content, sort_keys=True, indent=1, allow_nan=False) + "\n")
    return path


def _plain(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]


def _percent(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "-"
