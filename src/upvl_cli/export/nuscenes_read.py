"""Boxes from tables of nuScenes, as upvl or a tool wrote them, in the ego axes of their frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from upvl_cli.datasets.nuscenes.calibration import poses_of
from upvl_cli.datasets.nuscenes.layout import Scene, Tables, find_scenes
from upvl_cli.datasets.nuscenes.records import time_of
from upvl_cli.datasets.nuscenes.tables import KeyedTable, Row, number_of, numbers_of, shown, text_of
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, boxes_of_rows, track_numbers
from upvl_cli.export.frame_times import frames_at_ns
from upvl_cli.export.nuscenes_names import track_of
from upvl_cli.export.world_axes import rows_in_ego, velocity_in_ego
from upvl_cli.types import Array

_MAX_POINTS = 1e9


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each scene that bears the name of a drive."""
    scenes = find_scenes(folder)
    opened: dict[Path, AnnotationTables] = {}
    found = {}
    for name, drive in drives.items():
        if name in scenes:
            tables = scenes[name].tables
            annotations = opened.setdefault(tables.folder, AnnotationTables(tables))
            found[name] = _read_scene(scenes[name], drive, annotations)
    return found


class AnnotationTables:
    """The tables of boxes of one folder, read once for all its scenes."""

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self.annotations = KeyedTable(tables.folder / "sample_annotation.json", "sample_token")
        self._instances = KeyedTable(tables.folder / "instance.json", "token")

    @cached_property
    def _categories(self) -> dict[str, str]:
        path = self._tables.folder / "category.json"
        rows = self._tables.by_token("category.json")
        return {token: text_of(row, "name", path) for token, row in rows.items()}

    def class_names(self, instances: Sequence[str]) -> list[str]:
        """Return the category of each object; raises `BadInput` where a table lacks one."""
        path, names = self._instances.path, {}
        for row in self._instances.rows(set(instances)):
            category = text_of(row, "category_token", path)
            if category not in self._categories:
                raise BadInput(
                    f"{path} names the category {shown(category)}, which category.json lacks; export again"
                )
            names[row["token"]] = self._categories[category]
        missing = [token for token in instances if token not in names]
        if missing:
            raise BadInput(f"{path} has no row {shown(missing[0])}, which {self.annotations.path.name} names")
        return [names[token] for token in instances]


def _read_scene(scene: Scene, drive: ExportDrive, tables: AnnotationTables) -> ExportBoxes:
    path = scene.tables.samples.path
    times_ns = {
        text_of(row, "token", path): time_of(row, path) for row in scene.tables.samples.rows({scene.token})
    }
    frames = frames_at_ns(drive, list(times_ns.values()), path)
    frame_of = dict(zip(times_ns, frames.tolist(), strict=True))
    rows = tables.annotations.rows(set(times_ns))
    path = tables.annotations.path
    frame = np.array([frame_of[row["sample_token"]] for row in rows], dtype=np.int64)
    poses = drive.world_from_ego[drive.places_of(frame)].copy()
    given = _ego_poses(scene, times_ns)
    for i, row in enumerate(rows):
        poses[i] = given.get(row["sample_token"], poses[i])
    instances = [text_of(row, "instance_token", path) for row in rows]
    return boxes_of_rows(
        rows_in_ego(poses_of(rows, path), sizes_lwh_m(rows, path), poses),
        frame=frame,
        track_id=track_numbers([track_of(token, drive.name) for token in instances]),
        class_name=np.array(tables.class_names(instances), dtype=str),
        velocity_mps=velocity_in_ego(_velocities(rows, path), poses),
        num_points=np.array([_num_points(row, path) for row in rows], dtype=np.int64),
    )


def _ego_poses(scene: Scene, times_ns: Mapping[str, int]) -> dict[str, Array]:
    """Return the pose of the car at each sample as the tables have it: their boxes are in those axes.

    A workspace may have refined its poses since. Of the files of a sample, that which is nearest in time counts.
    """
    data, table = scene.tables.sample_data, scene.tables.ego_poses
    if not data.path.is_file() or not table.path.is_file():
        return {}
    nearest: dict[str, tuple[int, str]] = {}
    for row in data.rows(set(times_ns)):
        sample, pose = row["sample_token"], text_of(row, "ego_pose_token", data.path)
        rank = abs(time_of(row, data.path) - times_ns[sample]), pose
        nearest[sample] = min(nearest.get(sample, rank), rank)
    rows = table.rows({pose for _, pose in nearest.values()})
    poses = dict(zip([row["token"] for row in rows], poses_of(rows, table.path), strict=True))
    return {sample: poses[pose] for sample, (_, pose) in nearest.items() if pose in poses}


def sizes_lwh_m(rows: Sequence[Row], path: Path) -> Array:
    """Return (n, 3) sizes: nuScenes has the width first."""
    return np.array([numbers_of(row, "size", 3, path) for row in rows]).reshape(-1, 3)[:, [1, 0, 2]]


def _velocities(rows: Sequence[Row], path: Path) -> Array:
    """Return (n, 3) velocities in the axes of the world, NaN where a row has none."""
    unknown = np.full(3, np.nan)
    found = [unknown if row.get("velocity") is None else numbers_of(row, "velocity", 3, path) for row in rows]
    return np.array(found).reshape(-1, 3)


def _num_points(row: Row, path: Path) -> int:
    if row.get("num_lidar_pts") is None:
        return -1
    return int(number_of(row, "num_lidar_pts", path, most=_MAX_POINTS))
