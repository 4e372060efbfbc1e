"""Segments of the Waymo Open Dataset's perception part below a folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.shared.folders import absolute
from upvl_cli.datasets.shared.paths import check_segment_name, find, unknown_segment
from upvl_cli.datasets.waymo.components import ComponentSegment
from upvl_cli.datasets.waymo.drive import WaymoDrive
from upvl_cli.datasets.waymo.frame_records import RecordSegment
from upvl_cli.errors import BadInput

_POSE_FOLDER = "vehicle_pose"
_SUFFIX = {"v2": ".parquet", "v1": ".tfrecord"}
_V1_NAME = re.compile(r"(?:segment-)?(.*?)(?:_with_camera_labels)?")
EXPECTED = (
    "<root>/vehicle_pose/<segment>.parquet (v2, beside lidar, camera_image, ...), <root>/training/vehicle_pose/..., "
    "or <root>/segment-<segment>_with_camera_labels.tfrecord (v1)"
)


class Waymo:
    """The segments below a folder: of v2 where there is a folder `vehicle_pose`, else of v1."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        """List the segments by the names of their files.

        Args:
            root: A folder that holds the folders of the components or the TFRecord files, directly or in folders
                of splits.

        Raises:
            BadInput: It holds no segment, or two of one name.
        """
        self._root = absolute(root)
        self._paths = _segment_paths(self._root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Context names of the segments, sorted."""
        return tuple(sorted(self._paths))

    def path(self, segment: str) -> Path:
        """Return the file of a segment that lists its frames: its poses in v2, all of it in v1.

        Args:
            segment: Name of the segment.

        Raises:
            BadInput: There is no such segment.
        """
        if segment not in self._paths:
            raise unknown_segment(self._root, segment, self.segments)
        return self._paths[segment]

    def open(self, segment: str) -> WaymoDrive:
        """Return the drive of that name.

        Args:
            segment: Name of the segment.

        Raises:
            BadInput: There is no such segment, or it is damaged.
        """
        path = self.path(segment)
        if path.suffix.lower() == _SUFFIX["v1"]:
            return WaymoDrive(segment, RecordSegment(path))
        return WaymoDrive(segment, ComponentSegment(path.parents[1], segment))


def _segment_paths(root: Path) -> dict[str, Path]:
    in_folders = ("", "*/", "*/*/")
    found = find(root, [f"{folder}{_POSE_FOLDER}/*" for folder in in_folders])
    paths = [path for path in found if path.suffix.lower() == _SUFFIX["v2"]]
    names = [path.stem for path in paths]
    if not paths:
        paths = [
            path
            for path in find(root, [f"{folder}*" for folder in in_folders])
            if path.suffix.lower() == _SUFFIX["v1"]
        ]
        names = [match.group(1) for path in paths if (match := _V1_NAME.fullmatch(path.stem))]
    segments: dict[str, Path] = {}
    for name, path in zip(names, paths, strict=True):
        check_segment_name(name, path)
        if name in segments:
            raise BadInput(f"{path} and {segments[name]} have one name; move one out of {root}")
        segments[name] = path
    if not segments:
        raise BadInput(f"{root} has no segment of the Waymo Open Dataset; expected {EXPECTED}")
    return segments
