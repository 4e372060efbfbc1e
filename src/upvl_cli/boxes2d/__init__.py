"""Sources of 2D boxes: detectors of a user, and tables of boxes. A source loads its libraries when it is opened."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING

from upvl_cli.boxes2d.base import BoxSourceFamily
from upvl_cli.errors import BadSetting

if TYPE_CHECKING:
    from upvl_cli.boxes2d.base import BoxSource2d
    from upvl_cli.boxes2d.config import SuppressionConfig
    from upvl_cli.types import Drive

NONE = "none"  # the value of `detector` without any box


def _onnx_files(path: str) -> tuple[Path, ...]:
    from upvl_cli.boxes2d.onnx import files

    return files(path)


def _onnx(path: str, drive: Drive, config: SuppressionConfig) -> BoxSource2d:
    from upvl_cli.boxes2d.onnx import YoloxDetector

    return YoloxDetector(path, config)


def _table_files(path: str) -> tuple[Path, ...]:
    from upvl_cli.boxes2d.table import files

    return files(path)


def _table(path: str, drive: Drive, config: SuppressionConfig) -> BoxSource2d:
    from upvl_cli.boxes2d.table import BoxTable2d

    return BoxTable2d(path, drive)


SOURCES: dict[str, BoxSourceFamily] = {
    "onnx": BoxSourceFamily(_onnx_files, _onnx, "onnx:/models/yolox_nano.onnx"),
    "table": BoxSourceFamily(_table_files, _table, "table:/data/boxes.parquet"),
}


def box_source_family(detector: str) -> tuple[BoxSourceFamily, str]:
    """Return the family that a value such as "onnx:/models/yolox.onnx" names, and what follows its colon.

    Raises:
        BadSetting: No family has that name.
    """
    name, _, path = detector.partition(":")
    if name not in SOURCES:
        close = difflib.get_close_matches(name, [*SOURCES, NONE], n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        known = ", ".join(repr(example) for example in (NONE, *(each.example for each in SOURCES.values())))
        raise BadSetting(
            f"boxes2d.toml: detector = {detector!r}: unknown source {name!r}{hint} (for example: {known})"
        )
    return SOURCES[name], path
