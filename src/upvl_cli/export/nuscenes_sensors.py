"""The sensors of a drive as tables of nuScenes, and their files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.frame_times import time_us
from upvl_cli.export.json_items import JsonItems
from upvl_cli.export.nuscenes_names import token_of
from upvl_cli.export.sweeps import write_picture
from upvl_cli.export.world_axes import quaternions_wxyz
from upvl_cli.types import Camera, Frame

LIDAR = "LIDAR_TOP"
_MAX_INTENSITY = 255.0


class SensorFiles:
    """Writes `sensor`, `calibrated_sensor` and `sample_data`, and with `with_data` the files that these name."""

    def __init__(self, folder: Path, tables: Mapping[str, JsonItems], *, with_data: bool) -> None:
        """Take the tables.

        Args:
            folder: The folder of the data set.
            tables: The open tables by name.
            with_data: Whether points and pictures are written.
        """
        self._folder, self._tables, self._with_data = folder, tables, with_data
        self._sensors: set[str] = set()

    def add(self, drive: ExportDrive, samples: list[str], losses: Losses) -> None:
        """Write the sensors of a drive.

        Args:
            drive: The drive.
            samples: Token of the sample of each frame.
            losses: Counts what the format cannot carry.
        """
        losses["cameras with a lens: the devkit of nuScenes takes pictures as those of a pinhole"] += sum(
            bool(camera.distortion.any()) for camera in drive.cameras
        )
        for camera in (None, *drive.cameras):
            self._add_sensor(drive, camera, samples)

    def _add_sensor(self, drive: ExportDrive, camera: Camera | None, samples: list[str]) -> None:
        channel = camera.name if camera else LIDAR
        sensor, mount = token_of("sensor", channel), token_of("calibrated_sensor", drive.name, channel)
        if channel not in self._sensors:
            self._sensors.add(channel)
            modality = "camera" if camera else "lidar"
            self._tables["sensor"].add({"token": sensor, "channel": channel, "modality": modality})
        pose = camera.ego_from_camera if camera else np.eye(4)  # points are written in ego axes
        self._tables["calibrated_sensor"].add(
            {
                "token": mount,
                "sensor_token": sensor,
                "translation": pose[:3, 3].tolist(),
                "rotation": quaternions_wxyz(pose).tolist(),
                "camera_intrinsic": camera.intrinsic.tolist() if camera else [],
                # Read by the tools of TIER IV's T4, which has the tables of nuScenes.
                "camera_distortion": camera.distortion.tolist()
                if camera and camera.distortion_model == "brown"
                else [],
            }
        )
        present = [
            place for place, frame in enumerate(drive.frames) if self._write_file(drive, camera, frame)
        ]
        tokens = [
            token_of("sample_data", drive.name, channel, drive.frames[place].index) for place in present
        ]
        for at, place in enumerate(present):
            frame = drive.frames[place]
            self._tables["sample_data"].add(
                {
                    "token": tokens[at],
                    "sample_token": samples[place],
                    "ego_pose_token": ego_pose_token(drive, frame),
                    "calibrated_sensor_token": mount,
                    "timestamp": time_us(frame.time_ns),
                    "fileformat": "jpg" if camera else "pcd",
                    "is_key_frame": True,
                    "height": camera.height_px if camera else 0,
                    "width": camera.width_px if camera else 0,
                    "filename": _file_name(drive, camera, frame),
                    "prev": tokens[at - 1] if at else "",
                    "next": tokens[at + 1] if at + 1 < len(tokens) else "",
                }
            )

    def _write_file(self, drive: ExportDrive, camera: Camera | None, frame: Frame) -> bool:
        """Write the file of a sensor; return whether there is one, or would be with the data."""
        if not self._with_data or drive.source is None:
            return True
        path = self._folder / _file_name(drive, camera, frame)
        if camera:
            write_picture(drive, frame.index, camera, path)
            return path.is_file()
        points = drive.source.points(frame.index)
        columns = [points.xyz_ego_m, points.intensity * _MAX_INTENSITY, points.sensor]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(np.column_stack(columns).astype("<f4").tobytes())
        return True


def ego_pose_token(drive: ExportDrive, frame: Frame) -> str:
    """Return the token of the car's pose at a frame."""
    return token_of("ego_pose", drive.name, frame.index)


def _file_name(drive: ExportDrive, camera: Camera | None, frame: Frame) -> str:
    """Return the path of a file below the folder of the data set; names of cameras come from data."""
    channel = re.sub(r"[^A-Za-z0-9_-]", "_", camera.name) if camera else LIDAR
    ending = "jpg" if camera else "pcd.bin"
    return f"samples/{channel}/{drive.name}__{channel}__{time_us(frame.time_ns)}.{ending}"
