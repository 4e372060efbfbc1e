"""Points and pictures of a drive, for tools that want them beside the labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.export.drive import ExportDrive
from upvl_cli.types import Array, Camera, Floats


def write_points_bin(drive: ExportDrive, frame: int, path: Path) -> None:
    """Write a sweep as KITTI's `.bin`: float32 x, y, z (ego axes), intensity."""
    points = _points(drive, frame)
    if points is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(points.astype("<f4").tobytes())


def write_points_pcd(drive: ExportDrive, frame: int, path: Path) -> None:
    """Write a sweep as binary PCD: float32 x, y, z (ego axes), intensity."""
    points = _points(drive, frame)
    if points is None:
        return
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\n"
        f"TYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def write_picture(drive: ExportDrive, frame: int, camera: Camera | None, path: Path) -> None:
    """Write the picture of a camera, in the format of the path's ending; nothing where there is none."""
    image = drive.source.image(frame, camera.name) if drive.source and camera else None
    if image is None:
        return
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.asarray(image.rgb)).save(path, quality=95)  # of JPEG; PNG is exact


def _points(drive: ExportDrive, frame: int) -> Floats | None:
    """Return (n, 4) x, y, z, intensity; None where the drive cannot be read."""
    if drive.source is None:
        return None
    points = drive.source.points(frame)
    columns: Array = np.column_stack([points.xyz_ego_m, points.intensity])
    return columns
