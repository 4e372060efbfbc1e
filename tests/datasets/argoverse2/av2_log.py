"""A small log in the layout of Argoverse 2, whose truth is known by construction.

The car drives 10 m/s along the city's y axis and leans forward by a degree; the ground of the city is at 20 m.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
from PIL import Image
from scipy.spatial.transform import Rotation

LOG = "0a1b2c3d-0000-3000-8000-00000000000a"
FIRST_NS, PERIOD_NS = 315_973_157_959_879_000, 100_000_000
SPEED_MPS = 10.0
GROUND_CITY_M, AXLE_M = 20.0, 0.33
ATTITUDE = Rotation.from_euler("ZY", [90, 1], degrees=True)  # heading of the car, and how it leans
START_CITY_M = np.array([1500.0, -300.0, GROUND_CITY_M + AXLE_M])
# The camera stands 1.5 m ahead of and above the axle and looks to the left.
MOUNT_M = np.array([1.5, 0.2, 1.1])
LEFT = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: x right = forward of the car, ...
FX, CX, CY = 100.0, 32.0, 24.0
WIDTH, HEIGHT = 64, 48


@dataclass(frozen=True)
class Log:
    """Where a written log lies."""

    root: Path
    folder: Path


def wxyz(rotation: Rotation) -> dict[str, Any]:
    x, y, z, w = np.moveaxis(rotation.as_quat(), -1, 0)
    return {"qw": np.atleast_1d(w), "qx": np.atleast_1d(x), "qy": np.atleast_1d(y), "qz": np.atleast_1d(z)}


def write_feather(path: Path, columns: dict[str, Any], compression: str = "lz4") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pyarrow.feather.write_feather(pa.table(columns), str(path), compression=compression)


def position_city_m(time_ns: Any) -> np.ndarray:
    """(n, 3) where the car is at times."""
    seconds = (np.atleast_1d(time_ns) - FIRST_NS) / 1e9
    return START_CITY_M + seconds[:, None] * np.array([0, SPEED_MPS, 0])


def sweep_times(sweeps: int) -> np.ndarray:
    return FIRST_NS + PERIOD_NS * np.arange(sweeps)


def sweep_columns(number: int) -> dict[str, Any]:
    """Forty points on a line to the left, the first 20 of up_lidar; half precision as in the data set."""
    total = 40
    return {
        "x": np.full(total, 2.0, np.float16),
        "y": np.linspace(3, 10, total).astype(np.float16),
        "z": np.full(total, 0.5 + number, np.float16),
        "intensity": np.arange(total).astype(np.uint8) + np.uint8(215),
        "laser_number": np.r_[np.arange(20), 32 + np.arange(20)].astype(np.uint8),
        "offset_ns": (np.arange(total) * 2_500_000).astype(np.int32),
    }


def write_log(root: Path, sweeps: int = 3, split: str = "val") -> Log:
    folder = root / split / LOG
    for number, time_ns in enumerate(sweep_times(sweeps).tolist()):
        write_feather(folder / f"sensors/lidar/{time_ns}.feather", sweep_columns(number))
    write_poses(folder, sweeps)
    write_cameras(folder, sweeps)
    write_annotations(folder, sweeps)
    write_map(folder)
    return Log(root, folder)


def write_poses(folder: Path, sweeps: int, compression: str = "zstd") -> None:
    """Poses every 5 ms, those of the sweeps among them but not that of the second."""
    times = np.arange(FIRST_NS - 20_000_000, FIRST_NS + PERIOD_NS * (sweeps - 1) + 20_000_000, 5_000_000)
    times = times[times != FIRST_NS + PERIOD_NS]
    position = position_city_m(times)
    turned = Rotation.concatenate([ATTITUDE] * len(times))
    columns = {"timestamp_ns": times, **wxyz(turned), **xyz(position)}
    write_feather(folder / "city_SE3_egovehicle.feather", columns, compression)


def xyz(position: np.ndarray) -> dict[str, Any]:
    return {name: position[:, axis] for axis, name in enumerate(("tx_m", "ty_m", "tz_m"))}


def write_cameras(folder: Path, sweeps: int) -> None:
    """Two cameras at 20 Hz, 12 ms after the sweep; the second is stereo and grey."""
    names = ["ring_side_left", "stereo_front_left"]
    both = {
        name: np.full(2, value) for name, value in (("cx_px", CX), ("cy_px", CY), ("k1", -0.3), ("k2", 0.1))
    }
    size = {"height_px": np.full(2, HEIGHT), "width_px": np.full(2, WIDTH)}
    focal = {"fx_px": np.full(2, FX), "fy_px": np.full(2, FX)}
    write_feather(
        folder / "calibration/intrinsics.feather",
        {"sensor_name": names, **focal, **both, "k3": np.zeros(2), **size},
    )
    mounts = Rotation.concatenate([LEFT, LEFT, Rotation.identity()])
    place = np.array([MOUNT_M, MOUNT_M, [1.35, 0, 1.64]])
    write_feather(
        folder / "calibration/egovehicle_SE3_sensor.feather",
        {"sensor_name": [*names, "up_lidar"], **wxyz(mounts), **xyz(place)},
    )
    for name in names:
        (folder / "sensors/cameras" / name).mkdir(parents=True, exist_ok=True)
        for number in range(2 * sweeps):
            time_ns = FIRST_NS + 12_000_000 + number * PERIOD_NS // 2
            grey = np.full((HEIGHT, WIDTH), 20 * number % 256, np.uint8)
            Image.fromarray(grey).save(folder / "sensors/cameras" / name / f"{time_ns}.jpg")


def write_annotations(folder: Path, sweeps: int) -> None:
    """A parked car ahead at all times, and a cyclist who rides 2 m/s faster than the car, at the first two."""
    times = sweep_times(sweeps)
    n = len(times)
    parked_city_m = START_CITY_M + [3, 20, 0]
    parked = ATTITUDE.inv().apply(parked_city_m - position_city_m(times))
    cyclist = np.array([[8.0, 2.0, 0.5], [8.2, 2.0, 0.5]])
    turn = Rotation.from_euler("z", np.r_[np.full(n, 180.0), 0.0, 0.0][:, None], degrees=True)
    write_feather(
        folder / "annotations.feather",
        {
            "timestamp_ns": np.r_[times, times[:2]],
            "track_uuid": ["parked"] * n + ["cyclist"] * 2,
            "category": ["LARGE_VEHICLE"] * n + ["BICYCLIST"] * 2,
            "length_m": np.r_[np.full(n, 5.0), 1.8, 1.8],
            "width_m": np.r_[np.full(n, 2.0), 0.6, 0.6],
            "height_m": np.r_[np.full(n, 3.0), 1.7, 1.7],
            **wxyz(turn),
            **xyz(np.concatenate([parked, cyclist])),
            "num_interior_pts": np.arange(n + 2),
        },
    )


def write_map(folder: Path) -> None:
    """Ground at 20 m, unknown beyond 8 m to the west of the car's way; turned grid of 0.3 m cells."""
    (folder / "map").mkdir(parents=True, exist_ok=True)
    heights = np.full((200, 300), GROUND_CITY_M, np.float16)
    # Columns run along y, rows against x: row = (1510 - x) / 0.3, column = (y + 330) / 0.3.
    heights[60:] = np.nan
    np.save(folder / f"map/{LOG}_ground_height_surface____PIT.npy", heights)
    grid = {"R": [0.0, 1.0, -1.0, 0.0], "t": [330.0, 1510.0], "s": 10 / 3}
    (folder / f"map/{LOG}___img_Sim2_city.json").write_text(json.dumps(grid))
