"""Scores against human labels as `upvl eval` wrote them: its files are read here, and no label is."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.errors import one_line
from upvl_cli.pipeline.workspace import Workspace

MOST_FILES = 12


@dataclass(frozen=True)
class ScoreTable:
    """One table of scores: its title, the names of its columns, and its rows of texts."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ScoreSheet:
    """What one evaluation came to.

    Attributes:
        name: What was scored, and which labels count.
        scope: Drives, frames, labels and boxes in words.
        notes: What to know before the figures are used.
        tables: Its tables.
    """

    name: str
    scope: str
    notes: tuple[str, ...]
    tables: tuple[ScoreTable, ...]


def score_sheets(workspace: Workspace, segments: Sequence[str]) -> Iterator[ScoreSheet]:
    """Yield the evaluations in `out/eval`.

    Args:
        workspace: The workspace that was scored.
        segments: Names of the drives of the report: scores of others are noted.
    """
    shards = [path for segment in segments if (path := workspace.shard("labels", segment)).exists()]
    newest = max((path.stat().st_mtime for path in shards), default=0.0)
    for path in sorted((workspace.out / "eval").glob("*.json"))[:MOST_FILES]:
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            yield _sheet(path, content, segments, is_old=path.stat().st_mtime < newest)
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            IndexError,
            AttributeError,
            RecursionError,
        ) as error:
            note = f"the file is damaged ({one_line(error)}); run upvl eval again"
            yield ScoreSheet(path.stem, "", (note,), ())


def _sheet(path: Path, content: Mapping[str, Any], segments: Sequence[str], *, is_old: bool) -> ScoreSheet:
    scope = content["scope"]
    scored = [str(name) for name in scope["segments"]]
    region = scope.get("region")
    area = (
        f", {_number(region['length_m'], 0)} x {_number(region['width_m'], 0)} m around the car"
        if region
        else ""
    )
    notes = []
    if set(scored) != set(segments):
        names = ", ".join(scored[:5]) + (", ..." if len(scored) > 5 else "")
        notes.append(f"scored were {len(scored)} drives ({names}), not the drives of this report")
    if is_old:
        notes.append("written before the labels of this report; to be sure, run upvl eval again")
    notes += [f"{segment} could not be scored: {reason}" for segment, reason in scope["left_out"].items()]
    if dropped := ", ".join(f"{items} {reason}" for reason, items in scope["dropped"].items() if items):
        notes.append(f"not counted: {dropped}")
    return ScoreSheet(
        name=f"{scope['what']}, {scope['mode']}{area}",
        scope=f"{len(scored)} drives, {scope['frames']} frames, {scope['labels']} human labels, {scope['boxes']} boxes",
        notes=tuple(notes),
        tables=tuple(_tables(content)),
    )  # fmt: skip


def _tables(content: Mapping[str, Any]) -> Iterator[ScoreTable]:
    parts = (
        ("detection", _detection_table),
        ("named", _named_table),
        ("tracking", _tracking_table),
        ("flow", _flow_table),
    )
    for key, table in parts:
        if part := content.get(key):
            yield table(part)


def _detection_table(scores: Any) -> ScoreTable:
    columns = ("objects", "IoU", "labels", "AP L1", "AP L2", "APH L1", "APH L2", "precision", "recall")
    rows = []
    for score in scores:
        numbers = (*score["ap"], *score["aph"], score["precision"], score["recall"])
        head = (str(score["objects"]), f"{score['iou']:g}", str(score["labels"][1]))
        rows.append((*head, *map(_number, numbers)))
    return ScoreTable("Boxes of any class (precision and recall at the best F1)", columns, tuple(rows))


def _named_table(scores: Any) -> ScoreTable:
    rows = [
        (f"{score['iou']:g}", *(_number(score[key]) for key in ("vehicle", "vru", "mean")))
        for score in scores
    ]
    title = "Average precision by class (L2); VRU are pedestrians and cyclists"
    return ScoreTable(title, ("IoU", "vehicle", "VRU", "mean"), tuple(rows))


def _tracking_table(scores: Any) -> ScoreTable:
    keys = ("mota", "motp", "miss", "false_positive", "mismatch")
    columns = ("IoU", "level", "labels", "MOTA", "MOTP", "missed", "false", "mismatched")
    rows = []
    for score in scores:
        head = (f"{score['iou']:g}", f"L{score['level']}", str(score["labels"]))
        rows.append((*head, *(_number(score[key]) for key in keys)))
    return ScoreTable("Tracks (CLEAR-MOT; MOTP is the mean of 1 - IoU)", columns, tuple(rows))


def _flow_table(flow: Any) -> ScoreTable:
    names = (
        ("dynamic_epe_m", "moving objects"),
        ("static_epe_m", "standing objects"),
        ("background_epe_m", "background"),
    )
    rows = [(name, _number(flow["errors"][key])) for key, name in names]
    return ScoreTable("Flow: mean end-point error of a sweep", ("points", "error (m)"), tuple(rows))


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
