"""One car whose numbers a person can check, and a drive with a handful of points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from export.labelled_drives import FORWARD
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.types import Camera, Frame, Image, Points

TIME_NS = 1_500_000_000_123_456_789
FRAME = 7


def car(**changes: object) -> ExportBoxes:
    """A car 10 m ahead and 2 m to the left, 4 m long, heading 90 degrees to the left, at 3 m/s."""
    columns = {
        "center_m": [[10.0, 2.0, 0.5]],
        "size_lwh_m": [[4.0, 2.0, 1.5]],
        "heading_rad": [np.pi / 2],
        "velocity_mps": [[0.0, 3.0, 0.0]],
        "score": [0.75],
        "track_id": [12],
        "frame": [FRAME],
        "class_name": ["car"],
        "num_points": [33],
    }
    return ExportBoxes(**{name: np.array(values) for name, values in (columns | changes).items()})


def drive_of_one_car(name: str = "one", **changes: object) -> ExportDrive:
    """The ego stands at (100, 200, 5) of the world and looks along its y."""
    pose = np.array([[0.0, -1, 0, 100], [1, 0, 0, 200], [0, 0, 1, 5], [0, 0, 0, 1]])
    front = Camera(
        "front", 640, 480, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5), FORWARD
    )
    return ExportDrive(name, (Frame(FRAME, TIME_NS),), pose[None], (front,), car(**changes))


def write(drive: ExportDrive, name: str, folder: Path, **options: object) -> dict[str, int]:
    """Export a drive; what it could not carry."""
    return export([drive], export_format(name), folder, ExportOptions(**options), Counter())


def read(name: str, folder: Path, drive: ExportDrive) -> ExportBoxes:
    """The boxes of a folder that is of one drive."""
    return read_back(export_format(name), folder, {drive.name: drive})[drive.name]


class PointDrive:
    """A source of points and pictures: three points, the first two in the car."""

    name = "one"
    frames = (Frame(FRAME, TIME_NS),)
    skipped: Mapping[str, int] = {}
    ground_z_m = 0.0
    files: tuple[Path, ...] = ()
    xyz_ego_m = np.array([[10.0, 2.0, 0.5], [10.5, 3.5, 0.25], [-7.25, 0.125, -1.5]])

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return drive_of_one_car().cameras

    @property
    def world_from_ego(self) -> np.ndarray:
        return drive_of_one_car().world_from_ego

    def points(self, frame: int) -> Points:
        zero = np.zeros(3)
        return Points(self.xyz_ego_m, np.array([0.0, 0.5, 1.0]), zero, zero, zero)

    def image(self, frame: int, camera: str) -> Image | None:
        return Image(np.full((480, 640, 3), 128, np.uint8), TIME_NS)
