"""Hand corrections: a layer over the auto labels, kept in `out/corrections/` and never in the labels themselves."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.export.drive import ExportBoxes
from upvl_cli.pipeline.tables import Table, footer_digest, write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.correction_rows import DELETED, CorrectionRow, corrections_table
from upvl_cli.types import Array, Bools, Frame, Ints, array, concat

FOLDER = "corrections"


@dataclass(frozen=True)
class Corrections(ExportBoxes):
    """Boxes that a person changed, in the ego axes of their frames.

    Attributes:
        change: (n,) "moved", "renamed", "new" or "deleted" (`stages.correction_rows`).
    """

    change: Array = array("str")


def corrections_path(workspace: Workspace, segment: str) -> Path:
    """Return where the corrections of a drive are kept."""
    return workspace.out / FOLDER / f"{segment}.parquet"


def corrected_segments(workspace: Workspace) -> tuple[str, ...]:
    """Return the drives that have corrections, by name."""
    return tuple(path.stem for path in sorted((workspace.out / FOLDER).glob("*.parquet")))


def write_corrections(
    workspace: Workspace, segment: str, frames: tuple[Frame, ...], corrections: Corrections, kept: int
) -> Path:
    """Keep the corrections of a drive, in place of earlier ones; return the path.

    Args:
        workspace: Holds the labels that were corrected.
        segment: Name of the drive.
        frames: All frames that a person has seen.
        corrections: What was changed in them.
        kept: Number of labels that the person left as they were.
    """
    path = corrections_path(workspace, segment)
    changes, counts = np.unique(corrections.change, return_counts=True)
    rows = (_row(segment, frame, corrections[corrections.frame == frame.index]) for frame in frames)
    stamp = json.dumps({"labels": labels_digest(workspace, segment), "made": "by hand"}, sort_keys=True)
    changed = {f"labels {change}": int(count) for change, count in zip(changes, counts, strict=True)}
    write(path, CorrectionRow, rows, stamp=stamp, counts=changed | {"labels kept": kept})
    return path


def read_corrections(workspace: Workspace, segment: str) -> Corrections:
    """Return the corrections of a drive.

    Raises:
        NotMade: There are none, or the labels have been made again since.
    """
    table = corrections_table(workspace.out / FOLDER, segment)
    parts = []
    for row in table:
        boxes = row.tracked_boxes
        columns = {name: getattr(boxes, name) for name in boxes.__dataclass_fields__}
        columns |= {"frame": np.full(len(boxes), row.frame), "num_points": row.num_points}
        parts.append(Corrections(**columns, class_name=row.class_name, change=row.change))
    return concat(parts, Corrections)


def reviewed_frames(workspace: Workspace, segment: str) -> Ints:
    """Return (n,) the frames of a drive that a person has seen; raises `NotMade` where there are none."""
    return np.array(Table(corrections_path(workspace, segment), CorrectionRow).frames, dtype=np.int64)


def corrected(labels: ExportBoxes, corrections: Corrections) -> tuple[ExportBoxes, Bools]:
    """Return the labels with the corrections over them, by frame, and (n,) which boxes a person changed.

    Args:
        labels: The auto labels of a drive.
        corrections: What a person changed in them.
    """
    touched = same_boxes(labels, corrections)
    present = corrections[corrections.change != DELETED]
    columns = {name: getattr(present, name) for name in labels.__dataclass_fields__}
    merged = concat([labels[~touched], ExportBoxes(**columns)], ExportBoxes)
    by_hand = np.arange(len(merged)) >= int((~touched).sum())
    order = np.lexsort([merged.track_id, merged.frame])
    return merged[order], by_hand[order]


def same_boxes(boxes: ExportBoxes, others: ExportBoxes) -> Bools:
    """Return (n,) whether each box has its frame and its track in common with one of the others."""
    keys = np.array(list(zip(boxes.frame.tolist(), boxes.track_id.tolist(), strict=True)), dtype="i8,i8")
    known = np.array(list(zip(others.frame.tolist(), others.track_id.tolist(), strict=True)), dtype="i8,i8")
    return np.isin(keys, known)


def labels_digest(workspace: Workspace, segment: str) -> str:
    """Return a digest of the labels of a drive: others have another."""
    return footer_digest(workspace.shard("labels", segment))


def _row(segment: str, frame: Frame, boxes: Corrections) -> CorrectionRow:
    return CorrectionRow(
        segment,
        frame.index,
        frame.time_ns,
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        np.nan_to_num(boxes.velocity_mps),
        boxes.num_points,
        boxes.score,
        boxes.track_id,
        boxes.class_name,
        boxes.change,
    )
