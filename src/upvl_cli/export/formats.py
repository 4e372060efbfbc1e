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


def _openlabel() -> ExportFormat:
    from upvl_cli.export.openlabel import FORMAT

    return FORMAT


def _cvat() -> ExportFormat:
    from upvl_cli.export.cvat import FORMAT

    return FORMAT


def _supervisely() -> ExportFormat:
    from upvl_cli.export.supervisely import FORMAT

    return FORMAT


def _xtreme1() -> ExportFormat:
    from upvl_cli.export.xtreme1 import FORMAT

    return FORMAT


def _sustechpoints() -> ExportFormat:
    from upvl_cli.export.sustechpoints import FORMAT

    return FORMAT


def _segments_ai() -> ExportFormat:
    from upvl_cli.export.segments_ai import FORMAT

    return FORMAT


def _coco() -> ExportFormat:
    from upvl_cli.export.coco import FORMAT

    return FORMAT


def _las() -> ExportFormat:
    from upvl_cli.export.las_points import FORMAT

    return FORMAT


def _ply() -> ExportFormat:
    from upvl_cli.export.ply_points import FORMAT

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
    "openlabel": FormatEntry("ASAM OpenLABEL 1.0: one JSON file a drive", _openlabel),
    "cvat": FormatEntry("CVAT 3D, its Kitti Raw Format 1.0: tracklet_labels.xml", _cvat),
    "supervisely": FormatEntry(
        "Supervisely point clouds; CVAT's Sly format, which keeps tracks", _supervisely
    ),
    "xtreme1": FormatEntry("Xtreme1: one result a frame, in the folders of its upload", _xtreme1),
    "sustechpoints": FormatEntry("SUSTechPOINTS: the label files of a scene", _sustechpoints),
    "segments-ai": FormatEntry("Segments.ai: label and sample of a cuboid sequence", _segments_ai),
    "coco": FormatEntry("COCO: rectangles of the boxes in the pictures", _coco),
    "las": FormatEntry("LAS 1.4: the points of each frame, with words, flow and tracks", _las),
    "ply": FormatEntry("PLY: the points of each frame, with words, flow and tracks", _ply),
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
