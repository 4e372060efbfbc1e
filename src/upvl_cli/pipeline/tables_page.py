"""The page that documents every table and column, from the schemas that the files have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pyarrow as pa

from upvl_cli.pipeline.packing import schema_of
from upvl_cli.pipeline.pipeline import AnyStage

_INTRODUCTION = """\
# The tables

Made by `make docs` from the declarations in `src/upvl_cli/stages/rows.py` and `picture_rows.py`; a test
compares the two.

Each stage writes one Parquet file a drive, `out/STAGE/SEGMENT.parquet`, or one for all drives, `out/STAGE/all.parquet`.
pandas, polars and duckdb read them without upvl. `out/labels/` is the table that users take.

- *One row a box*: all boxes of a frame follow each other. A frame without boxes has no row; the footer of the file
  lists every frame. Join on `segment`, `frame` and, where there is one, `track_id`.
- *One row a frame*: a cell holds a list where the column says "for each" point, dimension or the like. Points keep
  the order of the sweep. An array of several dimensions is stored flat, the last axis fastest; its shape is
  given. `binary` holds the int8 values themselves, one byte each.
- Meaning, unit, axes and shape also stand in the metadata of each column of the file.
- Axes: *ego* is x forward, y left, z up; see [conventions.md](conventions.md).
"""


def tables_page(stages: Sequence[AnyStage]) -> str:
    """Return the page of all tables, as Markdown.

    Args:
        stages: The stages, in the order in which their tables are shown.
    """
    return "\n".join([_INTRODUCTION, *(line for stage in stages for line in _table(stage))])


def _table(stage: AnyStage) -> Iterator[str]:
    description = (stage.row.__doc__ or "").strip().splitlines()[0]
    file = "out/{}/all.parquet" if stage.is_of_dataset else "out/{}/SEGMENT.parquet"
    kind = "box" if stage.row.per_box else "dataset" if stage.is_of_dataset else "frame"
    yield from (f"## {stage.name}", "", f"{description} `{file.format(stage.name)}`, one row a {kind}.", "")
    yield from ("| column | type | for each | shape | unit | axes | meaning |", "| --- " * 7 + "|")
    for field in schema_of(stage.row):
        facts = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
        row = [
            f"`{field.name}`",
            _type(field.type, facts["items"]),
            _owner(facts["per"], kind),
            # The parts of a split column are columns of their own: each holds one number.
            facts.get("shape", "").replace(" ", " x ") if _is_list(field.type) else "",
            facts.get("unit", ""),
            facts.get("axes", ""),
            facts["meaning"],
        ]
        yield f"| {' | '.join(row)} |"
    yield ""


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_binary(kind))


def _type(kind: pa.DataType, items: str) -> str:
    if pa.types.is_binary(kind):
        return f"binary of {items}"
    return f"list of {items}" if pa.types.is_list(kind) else items


def _owner(per: str, kind: str) -> str:
    """Return what has one value of a column each; one row of a dataset has no frame."""
    return kind if per == "frame" and kind == "dataset" else per
