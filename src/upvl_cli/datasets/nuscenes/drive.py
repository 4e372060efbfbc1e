"""One scene of nuScenes, Lyft Level 5 or T4."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from upvl_cli.datasets.nuscenes.calibration import camera_of, ego_from_sensor, poses_of
from upvl_cli.datasets.nuscenes.ego_points import is_at_lidar, is_on_zoe
from upvl_cli.datasets.nuscenes.layout import Scene
from upvl_cli.datasets.nuscenes.pictures import IndexedSweep, pictures_of
from upvl_cli.datasets.nuscenes.records import Channel, SensorFile, lidar_of, read_channels
from upvl_cli.datasets.shared.folders import present_files
from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.pictures import read_picture
from upvl_cli.datasets.shared.point_files.read import read_points
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array, Camera, Frame, Image, Points

_COLUMNS = 5  # x, y, z, intensity, ring
_MAX_INTENSITY = 255.0
_TABLES = ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor")


@dataclass(frozen=True, eq=False)
class NuScenesDrive:
    """One scene.

    It has all that a `Drive` has, and also:

    Attributes:
        sweeps: The file of each of `frames`, by index.
        ego_from_lidar: Mount of the LiDAR.
        pictures: The pictures of each camera, by frame.
        kind: "nuscenes", "lyft" or "t4".
    """

    name: str
    frames: tuple[Frame, ...]
    sweeps: Mapping[int, SensorFile]
    ego_from_lidar: Array
    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Mapping[int, SensorFile]]
    world_from_ego: Array | None
    kind: str
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    skipped_points: dict[int, Mapping[str, int]] = field(default_factory=dict)

    @cached_property
    def ground_z_m(self) -> float:
        """Height of the road: 0, where the ego axes of nuScenes and T4 stand; for Lyft measured in the first sweep."""
        if self.kind != "lyft":
            return 0.0
        return road_height_m(self.points(self.frames[0].index).xyz_ego_m)

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame without the car itself.

        Raises:
            BadInput: There is no such frame, or its file is damaged.
        """
        scan = read_points(of_frame(self.name, self.sweeps, frame).path, columns=_COLUMNS)
        self.skipped_points[frame] = scan.skipped
        xyz_ego_m = apply(self.ego_from_lidar, scan.xyz_m).astype(np.float32)
        intensity = np.zeros(len(scan)) if scan.intensity is None else scan.intensity
        if self.kind == "nuscenes":
            kept = ~is_on_zoe(xyz_ego_m)
        else:
            kept = ~is_at_lidar(scan.xyz_m) if self.kind == "lyft" else np.ones(len(scan), dtype=np.bool_)
        total = int(kept.sum())
        return Points(
            xyz_ego_m=xyz_ego_m[kept],
            intensity=np.clip(intensity[kept] / _MAX_INTENSITY, 0.0, 1.0),
            elongation=np.zeros(total, np.float32),
            sensor=np.zeros(total, np.uint8),
            time_offset_ns=np.zeros(total, np.int64),
        )

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera that belongs to a sweep, or None where there is none.

        Raises:
            BadInput: There is no such frame or camera, or the file is damaged.
        """
        found = camera_of_name(self.name, self.cameras, camera)
        of_frame(self.name, self.sweeps, frame)
        record = self.pictures[camera].get(frame)
        if record is None:
            return None
        return Image(read_picture(record.path, found.width_px, found.height_px, record.path), record.time_ns)


def open_drive(scene: Scene) -> NuScenesDrive:
    """Return the drive of a scene; raises `BadInput` where it has no sweep, or a table is damaged."""
    skipped: Counter[str] = Counter()
    channels = read_channels(scene, skipped)
    lidar = lidar_of(channels, scene)
    poses = _poses(scene, lidar)
    sweeps = _sweeps(scene, lidar, poses, skipped)
    mounts = scene.tables.folder / "calibrated_sensor.json"
    cameras, pictures = [], {}
    for name, channel in sorted(channels.items()):
        if channel.modality != "camera":
            continue
        there = present_files([record.path for record in channel.records])
        present = tuple(record for record in channel.records if record.path in there)
        if len(present) < len(channel.records):
            skipped[f"{name} picture without file"] += len(channel.records) - len(present)
        if present:
            cameras.append(camera_of(Channel(name, channel.modality, channel.mount, present), mounts))
            pictures[name] = pictures_of(sweeps, present)
    tables = [scene.tables.folder / f"{name}.json" for name in _TABLES]
    images = {record.path for of_camera in pictures.values() for record in of_camera.values()}
    where = f"{scene.tables.sample_data.path}, {scene.name}"
    is_lyft = not sweeps[0].record.path.name.lower().endswith(".pcd.bin")
    return NuScenesDrive(
        name=scene.name,
        frames=check_frames([Frame(sweep.index, sweep.record.time_ns) for sweep in sweeps], where),
        sweeps={sweep.index: sweep.record for sweep in sweeps},
        ego_from_lidar=ego_from_sensor(lidar, mounts),
        cameras=tuple(cameras),
        pictures=pictures,
        world_from_ego=np.stack([poses[sweep.record.pose_token] for sweep in sweeps]),
        kind="t4" if scene.tables.is_t4 else "lyft" if is_lyft else "nuscenes",
        skipped={reason: count for reason, count in skipped.items() if count},
        files=tuple(sorted({*tables, *images, *(sweep.record.path for sweep in sweeps)})),
    )


def _poses(scene: Scene, lidar: Channel) -> dict[str, Array]:
    """Return the poses of the car at the sweeps, by token."""
    table = scene.tables.ego_poses
    rows = table.rows({record.pose_token for record in lidar.records})
    return dict(zip([row["token"] for row in rows], poses_of(rows, table.path), strict=True))


def _sweeps(
    scene: Scene, lidar: Channel, poses: Mapping[str, Array], skipped: Counter[str]
) -> list[IndexedSweep]:
    """Return the sweeps that have a file and a pose; their index counts all sweeps of the scene."""
    sweeps = []
    there = present_files([record.path for record in lidar.records])
    for index, record in enumerate(lidar.records):
        if record.path not in there:
            skipped["sweep without file"] += 1
        elif record.pose_token not in poses:
            skipped["sweep without pose"] += 1
        else:
            sweeps.append(IndexedSweep(index, record))
    if not sweeps:
        reasons = ", ".join(f"{count} {reason}" for reason, count in skipped.items())
        raise BadInput(
            f"{scene.tables.root} has no sweep of {scene.name} ({reasons}); expected "
            f"{lidar.records[0].path} and others, as the tables name them: unpack the blobs beside the tables"
        )
    return sweeps
