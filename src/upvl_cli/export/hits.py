"""The hits of a query as drives that can be exported."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.gather import drive_with_boxes
from upvl_cli.export.run import export
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.find import Hits
from upvl_cli.types import Ints

_FIRST_DATE = (1980, 1, 1, 0, 0, 0)  # of a ZIP file: the same hits give the same bytes


def drives_of_hits(
    workspace: Workspace, source: str, hits: Hits, class_names: Sequence[str]
) -> Iterator[ExportDrive]:
    """Yield each drive with a hit, with the boxes that are hits, named as they were asked for.

    Args:
        workspace: Holds the boxes that were searched.
        source: "labels" or "detections": what was searched.
        hits: The hits.
        class_names: Names of the queried classes.
    """
    for segment in np.unique(hits.segment).tolist():
        drive = drive_with_boxes(workspace, segment, source, "class")
        of_drive = hits[hits.segment == segment]
        boxes = drive.boxes
        # A label is known by its track; a detection can be without one, and is known by its row.
        own, asked = (
            (boxes.track_id, of_drive.track_id)
            if source == "labels"
            else (_rows_in_frame(boxes.frame), of_drive.box)
        )
        keys = zip(of_drive.frame.tolist(), asked.tolist(), strict=True)
        name_of = dict(zip(keys, (class_names[index] for index in of_drive.class_index), strict=True))
        names = [name_of.get(key) for key in zip(boxes.frame.tolist(), own.tolist(), strict=True)]
        is_hit = np.array([name is not None for name in names], dtype=np.bool_)
        found = replace(
            boxes[is_hit], class_name=np.array([name for name in names if name is not None], dtype=str)
        )
        yield drive.with_boxes(found)


def zip_of_export(drives: Iterable[ExportDrive], fmt: ExportFormat) -> bytes:
    """Return an export as the bytes of a ZIP file."""
    file = io.BytesIO()
    with tempfile.TemporaryDirectory() as parent, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
        folder = Path(parent) / fmt.name
        export(drives, fmt, folder, ExportOptions(), Losses())
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                entry = zipfile.ZipInfo(str(path.relative_to(parent)), _FIRST_DATE)
                packed.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _rows_in_frame(frame: Ints) -> Ints:
    """Return (n,) the place of each box among those of its frame; `frame` is ascending."""
    return np.arange(len(frame)) - np.searchsorted(frame, frame)
