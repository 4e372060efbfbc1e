"""The points of one frame as a table."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.types import Array
from upvl_cli.viewer.drive_tables import DriveTables, FramePoints

Column = tuple[str, Array | pa.Array, dict[str, str]]  # name, values, what its field says


def point_table(tables: DriveTables, frame: int) -> pa.Table:
    """Return the points of a frame, one row a point; a column that was not made is left out.

    Args:
        tables: The drive.
        frame: Number of the frame.

    Raises:
        BadSetting: There is no such frame.
        BadInput: The drive cannot be read.
    """
    frames = list(tables.times_ns)
    if frame not in tables.times_ns:
        span = f"{frames[0]} to {frames[-1]}" if frames else "no frame at all"
        raise BadSetting(f"{tables.segment} has no frame {frame}: it has {span}")
    points = tables.points(frame)
    if points is None:
        raise BadInput(f"{tables.segment}: {tables.missing[0]}")
    columns = [(name, pa.array(values), metadata) for name, values, metadata in _columns(points)]
    fields = [pa.field(name, values.type, metadata=metadata) for name, values, metadata in columns]
    return pa.Table.from_arrays([values for _, values, _ in columns], schema=pa.schema(fields))


def _columns(points: FramePoints) -> Iterator[Column]:
    sweep = points.points
    for place, axis in enumerate("xyz"):
        yield f"{axis}_m", sweep.xyz_ego_m[:, place], _field_metadata("position", "m", "ego")
    yield "intensity", sweep.intensity, _field_metadata("strength of the return")
    if points.flow_mps is not None:
        flow_mps = np.asarray(points.flow_mps, dtype=np.float32)
        for place, axis in enumerate("xyz"):
            yield (
                f"flow_{axis}_mps",
                flow_mps[:, place],
                _field_metadata("velocity over the ground", "m/s", "ego"),
            )
    if points.height_m is not None:
        height_m = np.asarray(points.height_m, dtype=np.float32)
        yield "height_m", height_m, _field_metadata("height above the ground below the point", "m")
    if points.is_ground is not None:
        yield "is_ground", points.is_ground, _field_metadata("part of the ground")
    if points.is_moving is not None:
        yield "is_moving", points.is_moving, _field_metadata("at least as fast as min_speed_mps of mask")
    if points.background is not None:
        yield "background", points.background, _field_metadata("1 background, 0 not, -1 unknown")
    if points.word_index is not None:
        words = np.array([*points.words, None], dtype=object)[points.word_index]  # NO_WORD is the last
        yield (
            "word",
            pa.array(words, pa.string()),
            _field_metadata("class of the point, or word of the label that holds it"),
        )


def _field_metadata(meaning: str, unit: str = "", axes: str = "") -> dict[str, str]:
    return {key: value for key, value in (("meaning", meaning), ("unit", unit), ("axes", axes)) if value}
