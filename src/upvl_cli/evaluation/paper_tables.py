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

from upvl_cli.evaluation.gather import Material, gather, labelled
from upvl_cli.evaluation.paper import COLUMNS, TABLES, PaperRow, PaperTable, Score
from upvl_cli.evaluation.params import EvalParams
from upvl_cli.evaluation.run import STAGE_OF
from upvl_cli.evaluation.score import detection_scores, named_scores, track_scores
from upvl_cli.runner import Made
from upvl_cli.settings import load
from upvl_cli.stages import LABELLING
from upvl_cli.sweep import make, preset_workspace
from upvl_cli.workspace import Workspace, write_if_changed

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


def missing(row: PaperRow, folder: Path) -> str:
    """The first thing that a row still needs, in words; empty where it can be made.

    Args:
        row: The row.
        folder: The presets.
    """
    made_here = [stage.name for stage in LABELLING]  # no detector is trained on the way
    stage = next((name for name in row.needs if name not in made_here), None)
    if stage:
        return f"no {stage} yet"
    if row.preset and not (folder / row.preset).is_dir():
        return f"no preset {row.preset} yet"
    return ""


def presets(workspace: Workspace) -> list[str]:
    """The presets that some row can be made with, each once, in the order of the tables; "" is what ships."""
    folder = workspace.stages / "presets"
    rows = (row for table in TABLES for row in table.rows)
    return list(dict.fromkeys(row.preset for row in rows if not missing(row, folder)))


class Watcher(Protocol):
    """What is told how far the making of shards is."""

    def tick(self) -> None:
        """One more frame is done."""

    def done(self, made: Made) -> None:
        """One more shard is done."""


def fill(workspace: Workspace, watcher: Watcher) -> Iterator[tuple[PaperTable, list[Filled]]]:
    """Make what the rows need, and fill all tables.

    Args:
        workspace: Where.
        watcher: Who is told of each frame and shard that is made.

    Raises:
        BadInput: No drive has labels.
        BadSetting: A preset or a value is wrong.
    """
    settings = replace(load(EvalParams, workspace.stages / "eval.toml"), iou=_IOUS)
    labelled(workspace)  # without labels there is no need to make anything
    made: dict[str, Workspace] = {}
    for name in presets(workspace):
        made[name] = preset_workspace(workspace, name) if name else workspace
        others = [other for other in made.values() if other not in (workspace, made[name])]
        for segment in workspace.segments:
            for shard in make(workspace, made[name], others, segment, watcher.tick):
                watcher.done(shard)

    @cache
    def gathered(preset: str, stage: str) -> Material:
        return gather(made[preset], stage, region=None, named=stage == STAGE_OF["labels"])

    for table in TABLES:
        rows = []
        for row in table.rows:
            reason = missing(row, workspace.stages / "presets")
            material = None if reason else gathered(row.preset, STAGE_OF[row.what])
            rows.append(_filled(table, row, material, reason, settings))
        yield table, rows


def _filled(
    table: PaperTable, row: PaperRow, material: Material | None, reason: str, settings: EvalParams
) -> Filled:
    nothing = (math.nan,) * len(COLUMNS[table.score])
    if material is None:
        return Filled(row, nothing, reason)
    if table.score == "named" and row.needs and not material.has_class:
        return Filled(row, nothing, f"no class of boxes in {STAGE_OF[row.what]} yet")
    ours = _scored(material, table, row, settings)
    return Filled(row, tuple(100 * value for value in ours), "")


def _scored(material: Material, table: PaperTable, row: PaperRow, settings: EvalParams) -> tuple[float, ...]:
    objects = material.without_classes()
    moving_only = table.moving_only
    if table.score == "tracking":
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
