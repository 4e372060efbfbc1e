"""The files of a scene, by sensor: what `sample_data` says of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.datasets.nuscenes.layout import Scene, Tables
from upvl_cli.datasets.nuscenes.tables import Row, number_of, row_name, shown, text_of
from upvl_cli.datasets.shared.folders import is_link
from upvl_cli.datasets.shared.paths import inside
from upvl_cli.errors import BadInput

_US = 1000  # times are in microseconds
_LIDARS = ("LIDAR_TOP", "LIDAR_CONCAT")


@dataclass(frozen=True)
class SensorFile:
    """One file of a sensor.

    Attributes:
        path: The file.
        time_ns: When the picture was taken, or the turn of the LiDAR ended.
        sample: Token of the sample (key frame) that it belongs to.
        is_key_frame: Whether it is the one of its sensor that was labelled with that sample.
        pose_token: Token of the pose of the car at that time.
        size_px: Width and height of a picture; 0 where the table has none.
    """

    path: Path
    time_ns: int
    sample: str
    is_key_frame: bool
    pose_token: str
    size_px: tuple[int, int]


@dataclass(frozen=True)
class Channel:
    """One sensor of a scene.

    Attributes:
        name: For example "CAM_FRONT".
        modality: "lidar", "camera" or "radar".
        mount: Its row of `calibrated_sensor`.
        records: Its files, in the order of time.
    """

    name: str
    modality: str
    mount: Row
    records: tuple[SensorFile, ...]


def read_channels(scene: Scene, skipped: Counter[str]) -> dict[str, Channel]:
    """Return the LiDAR and the cameras of a scene by name.

    Args:
        scene: The scene.
        skipped: Counts what is left out.

    Raises:
        BadInput: A table is damaged, or a sensor has two calibrations in the scene.
    """
    tables, path = scene.tables, scene.tables.sample_data.path
    sample_path = tables.samples.path
    samples = {text_of(row, "token", sample_path) for row in tables.samples.rows({scene.token})}
    by_mount: dict[str, list[Row]] = {}
    for row in tables.sample_data.rows(samples):
        by_mount.setdefault(text_of(row, "calibrated_sensor_token", path), []).append(row)
    channels: dict[str, Channel] = {}
    for token, rows in by_mount.items():
        mount, name, modality = _sensor(token, tables)
        if modality not in ("lidar", "camera"):
            continue
        if name in channels:
            raise BadInput(
                f"{path}: {name} has two calibrations in {scene.name}, expected one; split the scene, or mend "
                "calibrated_sensor_token"
            )
        records = [_record(row, tables) for row in rows if _is_valid(row, name, skipped)]
        channels[name] = Channel(name, modality, mount, tuple(sorted(records, key=lambda one: one.time_ns)))
    return channels


def lidar_of(channels: Mapping[str, Channel], scene: Scene) -> Channel:
    """Return the LiDAR that is read: LIDAR_TOP, LIDAR_CONCAT, or the only one."""
    lidars = [channel for channel in channels.values() if channel.modality == "lidar" and channel.records]
    best = [channel for name in _LIDARS for channel in lidars if channel.name == name]
    if best or len(lidars) == 1:
        return (best or lidars)[0]
    found = ", ".join(channel.name for channel in lidars) or "none"
    raise BadInput(
        f"{scene.tables.folder}: of {scene.name} the LiDARs are {found}; expected LIDAR_TOP, LIDAR_CONCAT or a "
        "single one"
    )


def _file_of(row: Row, tables: Tables) -> Path:
    """Return the file of a row. Where a folder leads is looked up once, and for each file only where it is a link."""
    where = f"{tables.sample_data.path}: row {row_name(row)}"
    name = text_of(row, "filename", tables.sample_data.path)
    parent, _, last = name.rpartition("/")
    if not name.isprintable():
        raise BadInput(
            f"{where} names {shown(name)}, expected the relative path of a file below {tables.root}"
        )
    if not parent or last in ("", ".", "..") or "\\" in name:
        return inside(tables.root, name, where)
    folder = tables.folders.get(parent)
    if folder is None:
        folder = tables.folders[parent] = inside(tables.root, parent, where)
    return inside(tables.root, name, where) if is_link(folder / last) else folder / last


def time_of(row: Row, path: Path) -> int:
    """Return the time of a row in nanoseconds; Lyft's microseconds have fractions."""
    time_us = number_of(row, "timestamp", path)
    return int(time_us) * _US + round((time_us - int(time_us)) * _US)


def _sensor(token: str, tables: Tables) -> tuple[Row, str, str]:
    """Return the calibration of a token, and name and modality of its sensor."""
    mounts, sensors = tables.folder / "calibrated_sensor.json", tables.folder / "sensor.json"
    mount = tables.mounts.get(token)
    if mount is None:
        raise BadInput(
            f"{mounts} has no row {shown(token)}, which sample_data.json names; copy the tables again"
        )
    sensor = tables.sensors.get(text_of(mount, "sensor_token", mounts))
    if sensor is None:
        raise BadInput(f"{sensors} has no row of the sensor of {shown(token)}; copy the tables again")
    name = text_of(sensor, "channel", sensors)
    if not name.isprintable():
        raise BadInput(f"{sensors}: channel of row {row_name(sensor)} is {shown(name)}, expected a name")
    return mount, name, text_of(sensor, "modality", sensors)


def _is_valid(row: Row, name: str, skipped: Counter[str]) -> bool:
    """Return whether a file counts: T4 marks those that do not."""
    if row.get("is_valid") is False:
        skipped[f"{name} file that is marked as not valid"] += 1
        return False
    return True


def _record(row: Row, tables: Tables) -> SensorFile:
    path = tables.sample_data.path
    width, height = (row.get(name) or 0 for name in ("width", "height"))
    return SensorFile(
        path=_file_of(row, tables),
        time_ns=time_of(row, path),
        sample=text_of(row, "sample_token", path),
        is_key_frame=row.get("is_key_frame") is True,
        pose_token=text_of(row, "ego_pose_token", path),
        size_px=(width, height) if isinstance(width, int) and isinstance(height, int) else (0, 0),
    )
