"""PLY: `<drive>/<frame>.ply`, binary, one vertex a point, with fields as `point_fields` names them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.point_files.ply import vertex_columns
from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.format import TRACK, ExportFormat, ExportOptions
from upvl_cli.export.point_fields import PointFields
from upvl_cli.export.tool_files import frame_name
from upvl_cli.types import Array

_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i2": "short", "i4": "int"}


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file a frame."""
    fields = PointFields(losses, options.world_axes)
    for drive in drives:
        if not fields.can_read(drive):
            continue
        (folder / drive.name).mkdir()
        for place, frame in enumerate(drive.frames):
            columns = fields.columns(drive, place)
            comments = [f"drive {drive.name} frame {frame.index} time_ns {frame.time_ns}"]
            comments += [
                f"word {number} {' '.join(name.split())}" for name, number in fields.words.number_of.items()
            ]
            comments += [f"class {number} {name}" for name, number in fields.classes.number_of.items()]
            content = ply_content(columns, comments)
            (folder / drive.name / f"{frame_name(frame.index)}.ply").write_bytes(content)
    fields.write_names(folder)


def ply_content(columns: Mapping[str, Array], comments: Iterable[str]) -> bytes:
    """Return a binary PLY file.

    Args:
        columns: (n,) values by the name of the property.
        comments: Lines of its header.
    """
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    rows = np.empty(len(columns["x"]), dtype)
    for name, values in columns.items():
        rows[name] = values
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header += [f"element vertex {len(rows)}"]
    header += [f"property {_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    return ("\n".join(header) + "\nend_header\n").encode() + rows.tobytes()


def read_ply_columns(path: Path) -> dict[str, Array]:
    """Return the columns of a file; raises `BadInput` where it is damaged."""
    return vertex_columns(path.read_bytes(), str(path))[1]


FORMAT = ExportFormat("ply", write, None, frozenset({TRACK}))
