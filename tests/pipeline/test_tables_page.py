"""docs/tables.md: generated, complete, and what the files say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from upvl_cli.config.base import Config
from upvl_cli.pipeline.packing import schema_of
from upvl_cli.pipeline.stage import Row, Stage, column
from upvl_cli.pipeline.tables_page import tables_page
from upvl_cli.stages import STAGES
from upvl_cli.types import Array

PAGE = Path(__file__).parents[2] / "docs" / "tables.md"


def test_the_committed_page_is_what_make_docs_writes() -> None:
    assert PAGE.read_text(encoding="utf-8") == tables_page(STAGES), "run: make docs"


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_every_column_of_a_file_has_a_line(stage: Stage) -> None:
    section = tables_page(STAGES).partition(f"## {stage.name}\n")[2].partition("\n## ")[0]
    shown = [line.split("`")[1] for line in section.splitlines() if line.startswith("| `")]
    assert shown == schema_of(stage.row).names


@dataclass(frozen=True)
class WeightRow(Row):
    """Weights of one frame."""

    mass: Array = column("float32", "mass", "kg", "ego", per="point", shape=(2, 3))


def test_a_column_shows_type_owner_shape_unit_and_axes() -> None:
    stage = Stage("weigh", lambda inputs, config: iter(()), Config, WeightRow, ("raw",))
    text = tables_page([stage])
    assert "Weights of one frame. `out/weigh/SEGMENT.parquet`, one row a frame." in text
    assert "| `mass` | list of float32 | point | 2 x 3 | kg | ego | mass |" in text
    assert "| `frame` | int64 | frame |  |  |  | number of the frame in its segment |" in text
