"""Hand corrections: a layer over the auto labels that a person makes and no stage does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.pipeline.stage import column
from upvl_cli.stages.rows import ScoredBoxRow, select

if TYPE_CHECKING:
    from pathlib import Path

    from upvl_cli.pipeline.tables import Table
    from upvl_cli.types import Array, TrackedBoxes

MOVED, RENAMED, NEW, DELETED = "moved", "renamed", "new", "deleted"


@dataclass(frozen=True)
class CorrectionRow(ScoredBoxRow):
    """What a person changed in the auto labels of one frame; labels that are not named are as they were."""

    class_name: Array = column(
        "string", "class that the person gave, or that of the label", per="box", names=("class",)
    )
    change: Array = column(
        "string",
        "moved: the box replaces the label of its track in place, size or heading, and perhaps class; renamed: in "
        "class alone; new: there was no label; deleted: the label is none",
        per="box",
    )


def corrections_table(folder: Path, segment: str) -> Table[CorrectionRow]:
    """Return the corrections of a drive.

    Args:
        folder: The folder of corrections, which stands beside that of the labels.
        segment: Name of the drive.

    Raises:
        NotMade: There are none, or the labels have been made again since.
    """
    import json

    from upvl_cli.errors import NotMade
    from upvl_cli.pipeline.tables import Table, footer_digest, read_footer

    path = folder / f"{segment}.parquet"
    table, footer = Table(path, CorrectionRow), read_footer(path)
    labels = footer_digest(folder.parent / "labels" / path.name)
    if footer is None or json.loads(footer.stamp).get("labels") != labels:
        raise NotMade(
            f"{path} corrects labels that have been made again since; export the labels again and repeat the "
            "corrections, or remove the file"
        )
    return table


def corrected_boxes(labels: ScoredBoxRow, corrections: CorrectionRow) -> TrackedBoxes:
    """Return the labels of one frame with the corrections over them: those of a person stand last."""
    import numpy as np

    from upvl_cli.types import TrackedBoxes, concat

    untouched = np.flatnonzero(~np.isin(labels.track_id, corrections.track_id))
    present = np.flatnonzero(corrections.change != DELETED)
    parts = [select(labels, untouched).tracked_boxes, select(corrections, present).tracked_boxes]
    return concat(parts, TrackedBoxes)
