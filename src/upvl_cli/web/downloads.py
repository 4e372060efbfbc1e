"""Hits as files: CSV in pieces, Parquet, or a format of an export."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from upvl_cli.errors import BadSetting
from upvl_cli.query.find import Hits
from upvl_cli.query.report import hits_as_table
from upvl_cli.query.vocabulary import Vocabulary

_ROWS = 500  # of a piece of CSV
EXPORT_FORMATS: tuple[
    str, ...
] = ()  # names that `export_hits` writes; the page offers them where there are any


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


def export_hits(hits: Hits, vocabulary: Vocabulary, format_name: str) -> Iterator[bytes]:
    """Yield hits as a file of one of `EXPORT_FORMATS`.

    Raises:
        BadSetting: There is no such format.
    """
    raise BadSetting(f"{format_name[:40]!r} is no format of an export; expected one of: csv, parquet")
