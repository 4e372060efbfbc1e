"""The cameras of a log. Its pictures are published without distortion, so k1 to k3 of its table are not applied."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.datasets.argoverse2.poses import QUATERNION, TRANSLATION
from upvl_cli.datasets.shared.arrow import read_feather, texts, values
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose, quaternion_rotation, rigid
from upvl_cli.errors import BadInput
from upvl_cli.types import Camera

INTRINSICS = "calibration/intrinsics.feather"
MOUNTS = "calibration/egovehicle_SE3_sensor.feather"
_MAX_PX = 1e5
_PIXELS = ("fx_px", "fy_px", "cx_px", "cy_px")


def read_cameras(folder: Path) -> dict[str, Camera]:
    """Return the calibrated cameras of a log by name; none where it has no calibration.

    Raises:
        BadInput: A table cannot be read, or one of the two is missing, or a number is not what it has to be.
    """
    paths = folder / INTRINSICS, folder / MOUNTS
    found = [path for path in paths if path.is_file()]
    if not found:
        return {}
    if len(found) == 1:
        missing = paths[0] if found[0] == paths[1] else paths[1]
        raise BadInput(f"{missing} is missing beside {found[0].name}; copy it from the data set")
    intrinsics, mounts = paths
    table = read_feather(intrinsics, ("sensor_name", *_PIXELS, "width_px", "height_px"))
    mount = read_feather(mounts, ("sensor_name", *QUATERNION, *TRANSLATION))
    names = _names(texts(table, "sensor_name", intrinsics), intrinsics)
    mounted = _names(texts(mount, "sensor_name", mounts), mounts)
    wxyz = np.stack([values(mount, name, "float64", mounts) for name in QUATERNION], axis=-1)
    xyz_m = np.stack([values(mount, name, "float64", mounts) for name in TRANSLATION], axis=-1)
    pose = rigid(quaternion_rotation(wxyz, f"{mounts}: a rotation"), xyz_m)
    ego_from_sensor = check_pose(pose, f"{mounts}: row", max_m=MAX_ON_CAR_M)
    pixels = np.stack([values(table, name, "float64", intrinsics) for name in _PIXELS], axis=-1)
    sizes = np.stack(
        [values(table, name, "int64", intrinsics) for name in ("width_px", "height_px")], axis=-1
    )
    cameras = {}
    for row, name in enumerate(names):
        if name not in mounted:
            raise BadInput(f"{mounts} has no row of {name!r}, which {intrinsics.name} has; copy both again")
        fx, fy, cx, cy = pixels[row].tolist()
        width, height = sizes[row].tolist()
        if not (0 < fx <= _MAX_PX and 0 < fy <= _MAX_PX and abs(cx) <= _MAX_PX and abs(cy) <= _MAX_PX):
            raise BadInput(
                f"{intrinsics}: {name!r} has fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}; copy it again"
            )
        if not (0 < width <= _MAX_PX and 0 < height <= _MAX_PX):
            raise BadInput(f"{intrinsics}: {name!r} has {width} x {height} pixels; copy it again")
        cameras[name] = Camera(
            name=name,
            width_px=width,
            height_px=height,
            intrinsic=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
            distortion=np.zeros(5),
            ego_from_camera=ego_from_sensor[mounted.index(name)],
        )
    return cameras


def _names(names: list[str], path: Path) -> list[str]:
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise BadInput(f"{path} has two rows of {twice[:80]}, expected one a sensor; copy it again")
    return names
