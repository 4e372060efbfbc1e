"""Hits as files: CSV in pieces, Parquet, or a format of an export."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from upvl_cli.export.formats import FORMATS, export_format
from upvl_cli.export.hits import drives_of_hits, zip_of_export
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.find import Hits
from upvl_cli.query.report import hits_as_table
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.web.answer import Answer

_ROWS = 500  # of a piece of CSV
_POINTS_OR_TABLE = {"csv", "las", "ply"}
# A ZIP file each; points are no hits, and the table is there as it is.
EXPORTS = {f"{name}.zip": name for name in FORMATS if name not in _POINTS_OR_TABLE}


def csv_of_hits(hits: Hits, vocabulary: Vocabulary) -> Iterator[bytes]:
    """Yield hits as CSV with a heading, some rows at a time."""
    table = hits_as_table(hits, vocabulary)
    yield _lines([table.column_names])
    for batch in table.to_batches(max_chunksize=_ROWS):
        columns = [column.to_pylist() for column in batch.columns]
        yield _lines([[_cell(value) for value in row] for row in zip(*columns, strict=True)])


def _lines(rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _cell(value: object) -> str:
    text = f"{value:.7g}" if isinstance(value, float) else str(value)
    # A spreadsheet would take such a text for a formula and compute it.
    return f"'{text}" if isinstance(value, str) and text[:1] in ("=", "+", "-", "@") else text


def parquet_of_hits(hits: Hits, vocabulary: Vocabulary) -> bytes:
    """Return hits as a Parquet file, the same as `upvl query` writes."""
    import pyarrow.parquet as pq

    file = io.BytesIO()
    pq.write_table(hits_as_table(hits, vocabulary), file, compression="zstd")
    return file.getvalue()


def export_hits(workspace: Workspace, source: str, answer: Answer, hits: Hits, name: str) -> bytes:
    """Return hits as the ZIP file of an export.

    Args:
        workspace: Holds the boxes.
        source: "labels" or "detections": what was searched.
        answer: The answer that the hits are of.
        hits: The hits that are saved.
        name: A key of `EXPORTS`.
    """
    # A workspace keeps one drive open: another thread may need another one.
    own = Workspace(workspace.pipeline, workspace.stages, workspace.out)
    drives = drives_of_hits(own, source, hits, answer.vocabulary.class_names)
    return zip_of_export(drives, export_format(EXPORTS[name]))
