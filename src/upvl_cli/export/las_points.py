"""LAS 1.4: `<drive>/<frame>.las`, fields that LAS does not know as extra bytes; places to the millimetre.

ASPRS, LAS specification 1.4 R15: classification 2 is ground and 1 unclassified; intensity is 16 bits, here 65535 for 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.format import TRACK, ExportFormat, ExportOptions
from upvl_cli.export.point_fields import PointFields
from upvl_cli.export.tool_files import frame_name
from upvl_cli.types import Array

_SCALE_M = 0.001
_POINT_FORMAT = 6  # the plainest of version 1.4
_UNCLASSIFIED, _GROUND = 1, 2
_MOST_INTENSITY = 65535
_NO_DATE = date(1970, 1, 1)  # no clock in files: laspy takes today where there is none
_OWN = ("x", "y", "z", "intensity")  # fields that LAS knows itself


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file a frame.

    Raises:
        BadSetting: The package laspy is not installed.
    """
    try:
        import laspy  # noqa: F401
    except ImportError:
        raise BadSetting("las needs the package laspy; run: pip install 'upvl[las]'") from None
    fields = PointFields(losses, options.world_axes)
    for drive in drives:
        if not fields.can_read(drive):
            continue
        (folder / drive.name).mkdir()
        for place, frame in enumerate(drive.frames):
            path = folder / drive.name / f"{frame_name(frame.index)}.las"
            _write_file(path, fields.columns(drive, place), losses)
    fields.write_names(folder)


def _write_file(path: Path, columns: Mapping[str, Array], losses: Losses) -> None:
    import laspy

    header = laspy.LasHeader(point_format=_POINT_FORMAT, version="1.4")
    header.creation_date = _NO_DATE
    header.generating_software = "upvl"
    header.scales = np.full(3, _SCALE_M)
    xyz = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    header.offsets = np.floor(xyz.mean(axis=0)) if len(xyz) and np.abs(xyz).max() > 1e5 else np.zeros(3)
    extra = [name for name in columns if name not in _OWN]
    header.add_extra_dims([laspy.ExtraBytesParams(name, columns[name].dtype) for name in extra])
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
    las.x, las.y, las.z = xyz.T
    losses["points whose intensity is above 1: written as 1"] += int((columns["intensity"] > 1).sum())
    intensity = np.clip(np.nan_to_num(columns["intensity"]), 0.0, 1.0)
    las.intensity = np.rint(intensity * _MOST_INTENSITY).astype(np.uint16)
    if "is_ground" in columns:
        las.classification = np.where(columns["is_ground"] > 0, _GROUND, _UNCLASSIFIED).astype(np.uint8)
    for name in extra:
        las[name] = columns[name]
    las.write(str(path))


def read_las_columns(path: Path) -> dict[str, Array]:
    """Return the columns of a file, with the places in metres and intensity from 0 to 1."""
    import laspy

    las = laspy.read(str(path))
    columns = {axis: np.asarray(getattr(las, axis)) for axis in "xyz"}
    columns["intensity"] = np.asarray(las.intensity) / _MOST_INTENSITY
    return columns | {name: np.asarray(las[name]) for name in las.point_format.extra_dimension_names}


FORMAT = ExportFormat("las", write, None, frozenset({TRACK}))
