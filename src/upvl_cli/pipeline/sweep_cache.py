"""Sweeps cached on disk for a stage that reads each of them many times, where making one anew takes long.

A built-in drive computes its sweeps, a second each. The folder is bounded and can be removed at any time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from upvl_cli.pipeline.stage import Row, column
from upvl_cli.pipeline.tables import Table, read_footer, write
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Points

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Array, Drive

_MOST_BYTES = 20 * 10**9  # drives beyond are read from where they are
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class SweepRow(Row):
    """One sweep."""

    ground_z_m: float = column("float64", "height of the road below the car", "m", "ego")
    xyz_ego_m: Array = column("float32", "places", "m", "ego", per="point", shape=(3,))
    intensity: Array = column("float32", "strength of the return", per="point")
    elongation: Array = column("float32", "width of the return's pulse", per="point")
    sensor: Array = column("uint8", "number of the LiDAR", per="point")
    time_offset_ns: Array = column("int64", "time after the frame's", "ns", per="point")

    @property
    def points(self) -> Points:
        """The sweep without the key."""
        return Points(self.xyz_ego_m, self.intensity, self.elongation, self.sensor, self.time_offset_ns)


@dataclass(frozen=True)
class CachedSweeps:
    """The sweeps of one drive: `read` gives that of a frame; `ground_z_m` is the drive's."""

    read: Callable[[int], Points]
    ground_z_m: float


def cached_sweeps(workspace: Workspace, segment: str, folder: Path) -> CachedSweeps:
    """Return the sweeps of a drive, which the first call copies to a folder where there is room.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
        folder: Folder of the copies.
    """
    path, stamp = folder / f"{segment}.parquet", workspace.raw_stamp(segment)
    if not _is_cached(path, stamp) and _size(folder) < _MOST_BYTES:
        write(
            path,
            SweepRow,
            _rows(workspace.drive(segment)),
            stamp=stamp,
            counts={},
            needed=lambda: not _is_cached(path, stamp),
        )
    if not _is_cached(path, stamp):
        return CachedSweeps(
            lambda frame: _read_from_drive(workspace, segment, frame), workspace.drive(segment).ground_z_m
        )
    table = Table(path, SweepRow)
    return CachedSweeps(lambda frame: table[frame].points, table[table.frames[0]].ground_z_m)


def _rows(drive: Drive) -> Iterator[SweepRow]:
    numbers = [frame.index for frame in drive.frames]
    for number, points in zip(numbers, in_order(drive.points, numbers), strict=True):
        yield SweepRow(
            drive.name,
            number,
            drive.ground_z_m,
            points.xyz_ego_m,
            points.intensity,
            points.elongation,
            points.sensor,
            points.time_offset_ns,
        )


def _read_from_drive(workspace: Workspace, segment: str, frame: int) -> Points:
    with _ONE_AT_A_TIME:  # a workspace keeps one drive open
        return workspace.drive(segment).points(frame)


def _is_cached(path: Path, stamp: str) -> bool:
    footer = read_footer(path)
    return footer is not None and footer.stamp == stamp


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob("*.parquet"))
