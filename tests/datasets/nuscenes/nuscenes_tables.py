"""Small scenes in the official tables of nuScenes, and as Lyft and TIER IV write them; the truth is by construction.

The car drives 10 m/s along its heading of 30 degrees. Sweeps come at 20 Hz, key frames at 2 Hz, pictures at 12 Hz.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

FIRST_US, SWEEP_US, KEY_US = 1_532_402_927_647_951, 50_000, 500_000
SPEED_MPS, HEADING = 10.0, Rotation.from_euler("z", 30, degrees=True)
START_WORLD_M = np.array([400.0, 1100.0, 0.0])
LIDAR_M = np.array([0.94, 0.0, 1.84])
LIDAR_ROTATION = Rotation.from_matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # x right, y forward
CAMERA_M = np.array([1.7, 0.0, 1.5])
CAMERA_ROTATION = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # x right, y down, z forward
FX, CX, CY, WIDTH, HEIGHT = 60.0, 32.0, 18.0, 64, 36
PICTURE_BEFORE_US = 35_000  # of a key frame, before the end of the turn
# Ego axes: a wall ahead to the left, 80 points; then four on the car, and one close behind it.
WALL = np.column_stack([np.linspace(5, 12, 80), np.linspace(3, 6, 80), np.linspace(0, 2, 80)])
ON_CAR = np.array([[1.0, 0.0, 1.6], [3.4, 0.5, 0.9], [-0.6, -0.8, 1.0], [0.94, 0.9, 1.5]])
BEHIND = np.array([[-1.2, 0.0, 0.5]])


@dataclass
class Tables:
    """Rows by table, and where they are written."""

    root: Path
    folder: Path
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def add(self, table: str, **row: Any) -> str:
        self.rows.setdefault(table, []).append(row)
        return str(row["token"])

    def write(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, rows in self.rows.items():
            # The official files stand one value a line.
            (self.folder / f"{name}.json").write_text(json.dumps(rows, indent=0))


def wxyz(rotation: Rotation) -> list[float]:
    x, y, z, w = rotation.as_quat().tolist()
    return [w, x, y, z]


def position_m(time_us: float) -> np.ndarray:
    return START_WORLD_M + HEADING.apply([SPEED_MPS * (time_us - FIRST_US) / 1e6, 0, 0])


def sweep_values(number: int, mount: tuple[Rotation, np.ndarray] = (LIDAR_ROTATION, LIDAR_M)) -> np.ndarray:
    """(85, 5) float32 as in a file: LiDAR axes, intensity 0 to 255, ring; the wall comes nearer."""
    ego = np.concatenate([WALL - [0.5 * number, 0, 0], ON_CAR, BEHIND])
    rotation, place = mount
    rows = np.column_stack(
        [rotation.inv().apply(ego - place), np.arange(len(ego)) * 3, np.arange(len(ego)) % 32]
    )
    return rows.astype("<f4")


def write_nuscenes(root: Path, version: str = "v1.0-mini", scenes: int = 1) -> Tables:
    tables = Tables(root, root / version)
    for name in ("attribute", "sample_annotation", "instance"):
        tables.rows[name] = []
    tables.add("sensor", token="s-lidar", channel="LIDAR_TOP", modality="lidar")
    tables.add("sensor", token="s-camera", channel="CAM_FRONT", modality="camera")
    tables.add("sensor", token="s-radar", channel="RADAR_FRONT", modality="radar")
    tables.add("category", token="c-car", name="vehicle.car", description="")
    tables.add("category", token="c-bicycle", name="vehicle.bicycle", description="")
    tables.add("category", token="c-cone", name="movable_object.trafficcone", description="")
    tables.add("attribute", token="a-rider", name="cycle.with_rider", description="")
    tables.add("attribute", token="a-none", name="cycle.without_rider", description="")
    for number in range(1, scenes + 1):
        write_scene(tables, f"scene-{number:04d}", sweeps=13)
    tables.write()
    return tables


def write_scene(tables: Tables, name: str, sweeps: int) -> None:
    mount_sensors(tables, name)
    keys = range(0, sweeps, KEY_US // SWEEP_US)
    samples = [f"{name}-key{number}" for number in keys]
    tables.add(
        "scene", token=f"t-{name}", name=name, description='says "sample_token": "x"', nbr_samples=len(keys)
    )
    for sample, number in zip(samples, keys, strict=True):
        time_us = FIRST_US + number * SWEEP_US
        tables.add("sample", token=sample, timestamp=time_us, scene_token=f"t-{name}", prev="", next="")
        add_annotations(tables, name, sample, time_us)
    for number in range(sweeps):
        # A sweep between key frames belongs to the sample that follows it, the last ones to the last sample.
        sample = samples[min(-(-number * SWEEP_US // KEY_US), len(samples) - 1)]
        is_key = number in keys
        folder, time_us = ("samples" if is_key else "sweeps"), FIRST_US + number * SWEEP_US
        path = f"{folder}/LIDAR_TOP/n015__LIDAR_TOP__{name}{time_us}.pcd.bin"
        add_file(tables, f"{name}-lidar{number}", path, time_us, sample, is_key, mount=f"{name}-m-lidar")
        write_sweep(tables.root / path, sweep_values(number))
    times = [(FIRST_US + number * SWEEP_US - PICTURE_BEFORE_US, number) for number in keys]
    times += [(FIRST_US - PICTURE_BEFORE_US + us, -1) for us in range(83_000, sweeps * SWEEP_US, 83_000)]
    for order, (time_us, number) in enumerate(times):
        is_key = number >= 0
        sample = samples[list(keys).index(number)] if is_key else samples[-1]
        path = f"{'samples' if is_key else 'sweeps'}/CAM_FRONT/n015__CAM_FRONT__{name}{time_us}.jpg"
        size = {"width": WIDTH, "height": HEIGHT}
        add_file(
            tables, f"{name}-camera{order}", path, time_us, sample, is_key, mount=f"{name}-m-camera", **size
        )
        write_picture(tables.root / path, order)


def mount_sensors(tables: Tables, name: str) -> None:
    lidar = {"translation": LIDAR_M.tolist(), "rotation": wxyz(LIDAR_ROTATION), "camera_intrinsic": []}
    tables.add("calibrated_sensor", token=f"{name}-m-lidar", sensor_token="s-lidar", **lidar)
    camera = {"translation": CAMERA_M.tolist(), "rotation": wxyz(CAMERA_ROTATION)}
    intrinsic = [[FX, 0.0, CX], [0.0, FX, CY], [0.0, 0.0, 1.0]]
    tables.add(
        "calibrated_sensor",
        token=f"{name}-m-camera",
        sensor_token="s-camera",
        **camera,
        camera_intrinsic=intrinsic,
    )
    tables.add("calibrated_sensor", token=f"{name}-m-radar", sensor_token="s-radar", **lidar)


def add_file(
    tables: Tables,
    token: str,
    path: str,
    time_us: float,
    sample: str,
    is_key: bool,
    *,
    mount: str,
    **size: int,
) -> None:
    tables.add(
        "sample_data",
        token=token,
        sample_token=sample,
        ego_pose_token=token,
        calibrated_sensor_token=mount,
        timestamp=time_us,
        fileformat=path.rpartition(".")[2],
        is_key_frame=is_key,
        height=size.get("height", 0),
        width=size.get("width", 0),
        filename=path,
        prev="",
        next="",
    )
    place = position_m(time_us).tolist()
    tables.add("ego_pose", token=token, timestamp=time_us, rotation=wxyz(HEADING), translation=place)


def write_sweep(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    values.tofile(path)


def write_picture(path: Path, grey: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((HEIGHT, WIDTH), 10 * grey % 256, np.uint8)).save(path)


def add_annotations(tables: Tables, name: str, sample: str, time_us: float) -> None:
    """A parked car that turns (!) from 170 to -170 degrees in half a second, a cyclist at 4 m/s, a bicycle alone."""
    seconds = (time_us - FIRST_US) / 1e6
    objects = {
        "car": ([420.0, 1110.0, 0.8], 170 + 40 * seconds, [1.9, 4.5, 1.6], "c-car", []),
        "cyclist": ([410.0 + 4 * seconds, 1120.0, 0.9], 0.0, [0.6, 1.8, 1.7], "c-bicycle", ["a-rider"]),
        "bicycle": ([415.0, 1090.0, 0.5], 90.0, [0.6, 1.8, 1.0], "c-bicycle", ["a-none"]),
    }
    if seconds == 0:
        objects["cone"] = ([405.0, 1101.0, 0.3], 0.0, [0.3, 0.3, 0.6], "c-cone", [])
    for what, (place, degrees, size_wlh, category, attributes) in objects.items():
        instance = f"{name}-{what}"
        if not any(row["token"] == instance for row in tables.rows["instance"]):
            tables.add("instance", token=instance, category_token=category, nbr_annotations=2)
        tables.add(
            "sample_annotation",
            token=f"{sample}-{what}",
            sample_token=sample,
            instance_token=instance,
            attribute_tokens=attributes,
            translation=place,
            size=size_wlh,
            rotation=wxyz(Rotation.from_euler("z", degrees, degrees=True)),
            num_lidar_pts=7,
            visibility_token="4",
        )


def write_lyft(root: Path) -> Tables:
    """As Lyft has it: all sweeps are key frames, times with fractions, other names of files and classes."""
    tables = write_nuscenes(root, "v1.01-train")
    for row in tables.rows["sample_data"]:
        row["timestamp"] += 0.25
        move(tables.root, row, "lidar" if "LIDAR" in row["filename"] else "images")
    for row in tables.rows["category"]:
        row["name"] = row["name"].rpartition(".")[2]
    tables.write()
    return tables


def move(root: Path, row: dict[str, Any], folder: str) -> None:
    name = row["filename"].rpartition("/")[2].replace(".pcd.bin", ".bin")
    (root / folder).mkdir(exist_ok=True)
    (root / row["filename"]).rename(root / folder / name)
    row["filename"] = f"{folder}/{name}"


def write_t4(root: Path, name: str = "dataset") -> Tables:
    """As TIER IV has it: `annotation/` and `data/`, LIDAR_CONCAT in ego axes, distorted cameras, one scene."""
    tables = write_nuscenes(root / name, "annotation")
    tables.rows["sensor"][0]["channel"] = "LIDAR_CONCAT"
    for row in tables.rows["calibrated_sensor"]:
        row["camera_distortion"] = [-0.1, 0.01, 0.001, 0.002, 0.0] if row["camera_intrinsic"] else []
        if row["sensor_token"] == "s-lidar":
            row.update(translation=[0.0, 0.0, 0.0], rotation=[1.0, 0.0, 0.0, 0.0])
    for number, row in enumerate(tables.rows["sample_data"]):
        (tables.root / "data/LIDAR_CONCAT").mkdir(parents=True, exist_ok=True)
        if "LIDAR" in row["filename"]:
            row["filename"] = f"data/LIDAR_CONCAT/{number}.pcd.bin"
            values = sweep_values(number, (Rotation.identity(), np.zeros(3)))
            values[:, 4] = -1
            write_sweep(tables.root / row["filename"], values)
        row["is_valid"] = number != 3
    for row in tables.rows["scene"]:
        row["name"] = f"project_{name}"
    tables.write()
    return tables
