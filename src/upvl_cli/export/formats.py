"""The formats that `upvl export` knows. Each is loaded only when it is used."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.errors import BadSetting

if TYPE_CHECKING:
    from upvl_cli.export.format import ExportFormat


@dataclass(frozen=True)
class FormatEntry:
    """A format as help lists it.

    Attributes:
        title: What it is, in one line.
        load: Loads it.
    """

    title: str
    load: Callable[[], ExportFormat]


def _csv() -> ExportFormat:
    from upvl_cli.export.csv_table import FORMAT

    return FORMAT


def _kitti() -> ExportFormat:
    from upvl_cli.export.kitti_object import FORMAT

    return FORMAT


def _kitti_tracking() -> ExportFormat:
    from upvl_cli.export.kitti_tracking import FORMAT

    return FORMAT


def _nuscenes() -> ExportFormat:
    from upvl_cli.export.nuscenes_tables import FORMAT

    return FORMAT


def _nuscenes_results() -> ExportFormat:
    from upvl_cli.export.nuscenes_results import FORMAT

    return FORMAT


def _argoverse2() -> ExportFormat:
    from upvl_cli.export.argoverse2 import FORMAT

    return FORMAT


def _waymo() -> ExportFormat:
    from upvl_cli.export.waymo_objects import FORMAT

    return FORMAT


def _waymo_parquet() -> ExportFormat:
    from upvl_cli.export.waymo_components import FORMAT

    return FORMAT


FORMATS: dict[str, FormatEntry] = {
    "csv": FormatEntry("one table a drive, one row a box", _csv),
    "kitti": FormatEntry("KITTI object: label_2 and calib, one file a frame", _kitti),
    "kitti-tracking": FormatEntry("KITTI tracking: label_02, one file a drive", _kitti_tracking),
    "nuscenes": FormatEntry("nuScenes: a data set of its 13 tables", _nuscenes),
    "nuscenes-results": FormatEntry("nuScenes: results of detection and tracking", _nuscenes_results),
    "argoverse2": FormatEntry(
        "Argoverse 2: annotations.feather, poses and cameras of each drive", _argoverse2
    ),
    "waymo": FormatEntry("Waymo: predictions as the message Objects, one file", _waymo),
    "waymo-parquet": FormatEntry("Waymo v2: the components lidar_box and vehicle_pose", _waymo_parquet),
}


def export_format(name: str) -> ExportFormat:
    """Return the format of a name.

    Raises:
        BadSetting: There is none of that name.
    """
    if name not in FORMATS:
        close = difflib.get_close_matches(name, FORMATS, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise BadSetting(f"unknown format {name!r}{hint} (known: {', '.join(FORMATS)})")
    return FORMATS[name].load()
