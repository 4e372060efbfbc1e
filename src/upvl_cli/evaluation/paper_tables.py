"""Fills the rows of the paper's tables on the drives of a workspace, beside the published figures."""

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
from upvl_cli.evaluation.gather import Material, gather, labelled
from upvl_cli.evaluation.paper import COLUMNS, TABLES, PaperRow, PaperTable, Score
from upvl_cli.evaluation.run import STAGE_OF
from upvl_cli.evaluation.score import detection_scores, named_scores, track_scores
from upvl_cli.pipeline.presets import make_detector, make_labels, preset_workspace
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed
from upvl_cli.stages import LABELLING, STAGES, train

_IOUS = (0.4, 0.5)  # those of the paper
_NOTE = "published: Waymo Open Dataset; ours: the drives of this workspace. Not the same data."
_NAMED_NOTE = f"{_NOTE} Ours is AP@0.4 L2."
_TRACK_NOTE = f"{_NOTE} Ours is at IoU 0.4 L2, whatever the class; of MOTP lower is better."
_NOTES: dict[Score, str] = {"class-agnostic": _NOTE, "named": _NAMED_NOTE, "tracking": _TRACK_NOTE}


@dataclass(frozen=True)
class Filled:
    """One row.

    Attributes:
        row: What is published.
        ours: One figure a column in percent; NaN where there is none.
        missing: Why it could not be filled; empty where it was.
    """

    row: PaperRow
    ours: tuple[float, ...]
    missing: str


def missing(row: PaperRow, folder: Path, *, detectors: bool) -> str:
    """The first thing that a row still needs, in words; empty where it can be made.

    Args:
        row: The row.
        folder: The presets.
        detectors: Whether detectors are trained on the way.
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
    """The presets that some row can be made with, each once, in the order of the tables; "" is what ships.

    Args:
        workspace: Where.
        detectors: Whether detectors are trained on the way.

    Returns:
        For each whether a row asks for its detector.
    """
    folder = workspace.stages / "presets"
    found: dict[str, bool] = {}
    for row in (row for table in TABLES for row in table.rows):
        if not missing(row, folder, detectors=detectors):
            found[row.preset] = found.get(row.preset, False) or row.what == "detections"
    return found


def scored_drives(workspace: Workspace, *, detectors: bool) -> list[str]:
    """The drives with labels; beside detectors those that none has learned from, for all rows alike.

    Raises:
        BadInput: No drive has labels.
        BadSetting: The detectors would learn from all of those.
    """
    named = list(labelled(workspace)[1])
    learned = workspace.drives_of(train.STAGE) if detectors else ()
    left = [name for name in named if name not in learned]
    if not left:
        raise BadSetting(
            f"the detectors would learn from every drive that has labels; expected some to score in: set drives in "
            f'{workspace.stages / "train.toml"}, such as drives = ["train-*"]'
        )
    return left


def shards(workspace: Workspace, *, detectors: bool) -> int:
    """How many shards `fill` makes or finds."""
    made, drives = presets(workspace, detectors=detectors), scored_drives(workspace, detectors=detectors)
    return len(made) * len(LABELLING) * len(workspace.segments) + sum(made.values()) * (1 + len(drives))


class Watcher(Protocol):
    """What is told how far the making of shards is."""

    def tick(self) -> None:
        """One more frame is done."""

    def done(self, made: Made) -> None:
        """One more shard is done."""


def fill(
    workspace: Workspace, watcher: Watcher, *, detectors: bool
) -> Iterator[tuple[PaperTable, list[Filled]]]:
    """Make what the rows need, and fill all tables.

    Args:
        workspace: Where.
        watcher: Who is told of each frame and shard that is made.
        detectors: Whether to train detectors, for the rows that score one.

    Raises:
        BadInput: No drive has labels.
        BadSetting: A preset or a value is wrong, or detectors leave no drive to score.
    """
    settings = replace(load(EvalConfig, workspace.stages / "eval.toml"), iou=_IOUS)
    drives = scored_drives(workspace, detectors=detectors)  # else there is no need to make anything
    made: dict[str, Workspace] = {}
    for name, learns in presets(workspace, detectors=detectors).items():
        mine = made[name] = preset_workspace(workspace, name) if name else workspace
        others = [other for other in made.values() if other not in (workspace, mine)]
        for segment in workspace.segments:
            for shard in make_labels(workspace, mine, others, segment, watcher.tick):
                watcher.done(shard)
        for shard in make_detector(workspace, mine, others, drives, watcher.tick) if learns else ():
            watcher.done(shard)

    @cache
    def gathered(preset: str, stage: str) -> Material:
        return gather(made[preset], stage, region=None, named=True, segments=drives)

    for table in TABLES:
        rows = []
        for row in table.rows:
            reason = missing(row, workspace.stages / "presets", detectors=detectors)
            material = None if reason else gathered(row.preset, STAGE_OF[row.what])
            rows.append(_filled(table, row, material, reason, settings))
        yield table, rows


def _filled(
    table: PaperTable, row: PaperRow, material: Material | None, reason: str, settings: EvalConfig
) -> Filled:
    nothing = (math.nan,) * len(COLUMNS[table.score])
    if material is None:
        return Filled(row, nothing, reason)
    ours = _scored(material, table, row, settings)
    return Filled(row, tuple(100 * value for value in ours), "")


def _scored(material: Material, table: PaperTable, row: PaperRow, settings: EvalConfig) -> tuple[float, ...]:
    objects = material.without_classes()
    moving_only = table.moving_only
    if table.score == "tracking":
        # A detection of no track follows nothing.
        tracked = objects.predictions[objects.predictions.object_id != "-1"]
        objects = replace(objects, predictions=tracked)
        level_2 = track_scores(objects, settings, moving_only=moving_only)[1]
        # Without a cut-off of positive MOTA the tool reports 0 for both, which is no precision of anything.
        return level_2.mota, level_2.motp if level_2.cutoff is not None else math.nan
    if table.score == "named" and row.needs:
        moving_mps = settings.moving_mps if moving_only else None
        return named_scores(material, iou=_IOUS[0], moving_mps=moving_mps)
    whole = [of for of in detection_scores(objects, settings, moving_only=moving_only) if of.objects == "all"]
    if table.score == "named":  # a row without names
        return math.nan, math.nan, whole[0].ap[1]
    return tuple(ap for score in whole for ap in score.ap)


def shown(table: PaperTable, rows: Sequence[Filled]) -> Table:
    """A table for the terminal: a line with the published figures, and where there are any a line with ours."""
    out = Table(title=table.title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    out.caption, out.caption_justify = _NOTES[table.score], "left"
    out.add_column("published", no_wrap=True)
    for name in COLUMNS[table.score]:
        out.add_column(name, justify="right", no_wrap=True)
    out.add_column("")
    for of in rows:
        out.add_row(of.row.name, *map(_percent, of.row.published), of.missing)
        if not of.missing:
            out.add_row("  ours", *map(_percent, of.ours), "")
    return out


def write(workspace: Workspace, tables: Sequence[tuple[PaperTable, Sequence[Filled]]]) -> Path:
    """Write all tables to `out/eval/tables.json`; returns its path."""
    content = [
        {
            "title": table.title,
            "columns": list(COLUMNS[table.score]),
            "note": _NOTES[table.score],
            "rows": [
                {
                    "name": of.row.name,
                    "preset": of.row.preset,
                    "published": _plain(of.row.published),
                    "ours": _plain(of.ours),
                    "missing": of.missing,
                }
                for of in rows
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
