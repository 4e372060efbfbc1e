"""Human boxes of the key frames, and between them, for evaluation only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from upvl_cli.datasets.nuscenes.calibration import pose_of
from upvl_cli.datasets.nuscenes.dataset import NuScenes
from upvl_cli.datasets.nuscenes.drive import NuScenesDrive
from upvl_cli.datasets.nuscenes.layout import Scene, Tables
from upvl_cli.datasets.nuscenes.records import time_of
from upvl_cli.datasets.nuscenes.tables import KeyedTable, Row, number_of, numbers_of, row_name, shown, text_of
from upvl_cli.datasets.shared.tracks import count_points, velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, compose, from_yaw, inverse, wrap_angle, yaw_of
from upvl_cli.types import Array, Bools, Ints, Labels, concat

# Waymo's numbers for names without what stands before the class: nuScenes has `vehicle.car`, Lyft `car`, T4 either.
_NO_RIDER = "without_rider"
_PREFIXES = {"vehicle.bicycle": 4, "vehicle.": 1, "human.pedestrian": 2, "pedestrian": 2}
_VEHICLES = (
    "car", "truck", "bus", "trailer", "motorcycle", "other_vehicle", "emergency_vehicle", "police_car", "fire_truck",
    "ambulance", "forklift",
)  # fmt: skip
_TYPES = {
    **dict.fromkeys(_VEHICLES, 1),
    **dict.fromkeys(
        ("construction_worker", "personal_mobility", "police_officer", "stroller", "wheelchair"), 2
    ),
    "bicycle": 4,
}
_MAX_M = 1e4


@dataclass(frozen=True)
class Annotation:
    """One box of a key frame, in the axes of the world.

    Attributes:
        instance: Token of its object.
        class_name: Its category.
        type: Waymo's number.
        center_m: (3,) its centre.
        size_lwh_m: (3,) its size.
        yaw_rad: Its heading.
        num_points: LiDAR points inside; -1 where the table has none.
    """

    instance: str
    class_name: str
    type: int
    center_m: Array
    size_lwh_m: Array
    yaw_rad: float
    num_points: int


class LabelTables:
    """The tables of labels of one folder, read once for all its scenes."""

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self.annotations = KeyedTable(tables.folder / "sample_annotation.json", "sample_token")
        self.instances = KeyedTable(tables.folder / "instance.json", "token")

    @cached_property
    def categories(self) -> dict[str, str]:
        """Names of the categories by token."""
        return self._names("category.json")

    @cached_property
    def attributes(self) -> dict[str, str]:
        """Names of the attributes by token; empty where there is no such table."""
        return self._names("attribute.json") if (self._tables.folder / "attribute.json").is_file() else {}

    def _names(self, name: str) -> dict[str, str]:
        path = self._tables.folder / name
        return {token: text_of(row, "name", path) for token, row in self._tables.by_token(name).items()}


class NuScenesLabels:
    """The boxes of scenes: those of the key frames, and linear between two neighboring ones for the frames between."""

    def __init__(self, dataset: NuScenes) -> None:
        self._dataset = dataset
        self._tables: dict[Path, LabelTables] = {}

    def labels(self, segment: str) -> Labels:
        """Return all boxes of `frames`; raises `BadInput` where the scene has none."""
        drive, scene = self._dataset.open(segment), self._dataset.scene(segment)
        keys = _key_frames(drive, scene)
        boxes = self._annotations(scene, set(keys))
        by_sample = list(keys)
        parts = {frame: _in_ego_axes(boxes[sample], frame, drive) for sample, frame in keys.items()}
        for first, second in pairwise(by_sample):
            for frame in _frames_between(drive, keys[first], keys[second]):
                between = _between(
                    boxes[first], boxes[second], _share(drive, keys[first], keys[second], frame)
                )
                parts[frame] = _in_ego_axes(between, frame, drive)
        labels = concat([parts[frame] for frame in sorted(parts)], Labels)
        labels = replace(
            labels, velocity_mps=velocities_of_tracks(labels, drive.frames, drive.world_from_ego)
        )
        return _count_unknown(labels, drive)

    def frames(self, segment: str) -> Ints:
        """Return the index of each frame from the first key frame to the last; raises `BadInput` without labels."""
        drive, scene = self._dataset.open(segment), self._dataset.scene(segment)
        keys = _key_frames(drive, scene)
        self._annotations(scene, set(keys))
        index = np.array([frame.index for frame in drive.frames])
        return index[(index >= min(keys.values())) & (index <= max(keys.values()))]

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return true for each place: labels reach as far as the LiDAR, all round."""
        return np.ones(len(xyz_ego_m), dtype=np.bool_)

    def _annotations(self, scene: Scene, samples: set[str]) -> dict[str, list[Annotation]]:
        folder = scene.tables.folder
        tables = self._tables.setdefault(folder, LabelTables(scene.tables))
        return _annotations(scene, samples, tables)


def _key_frames(drive: NuScenesDrive, scene: Scene) -> dict[str, int]:
    """Return the frame of each sample, in the order of time: its key frame, or else its sweep nearest in time."""
    path = scene.tables.samples.path
    time_ns = {
        text_of(row, "token", path): time_of(row, path) for row in scene.tables.samples.rows({scene.token})
    }
    best: dict[str, tuple[bool, int, int]] = {}
    for frame, record in drive.sweeps.items():
        rank = (not record.is_key_frame, abs(record.time_ns - time_ns[record.sample]), frame)
        best[record.sample] = min(best.get(record.sample, rank), rank)
    frames = {sample: frame for sample, (_, _, frame) in best.items()}
    return dict(sorted(frames.items(), key=lambda item: item[1]))


def _annotations(scene: Scene, samples: set[str], tables: LabelTables) -> dict[str, list[Annotation]]:
    """Return the boxes of each sample; raises `BadInput` where the scene has none at all."""
    table = tables.annotations
    if not table.path.is_file():
        raise BadInput(f"{scene.tables.folder} has no labels; expected sample_annotation.json")
    rows = table.rows(samples)
    if not rows:
        raise BadInput(f"{table.path} has no label of {scene.name}, as all scenes of a test split")
    names = _class_names(tables, {text_of(row, "instance_token", table.path) for row in rows})
    boxes: dict[str, list[Annotation]] = {sample: [] for sample in samples}
    for row in rows:
        boxes[row["sample_token"]].append(_annotation(row, table, names, tables.attributes))
    for sample, here in boxes.items():
        if len({box.instance for box in here}) < len(here):
            raise BadInput(
                f"{table.path}: sample {shown(sample)} has two boxes of one instance; copy it again"
            )
    return boxes


def _class_names(tables: LabelTables, instances: set[str]) -> dict[str, str]:
    """Return the category of each object."""
    names, path = {}, tables.instances.path
    for row in tables.instances.rows(instances):
        name = tables.categories.get(text_of(row, "category_token", path))
        if name is None:
            raise BadInput(
                f"{path} names a category of {row_name(row)} that category.json lacks; copy both again"
            )
        names[row["token"]] = name
    return names


def _annotation(
    row: Row, table: KeyedTable, names: Mapping[str, str], attributes: Mapping[str, str]
) -> Annotation:
    path, instance = table.path, text_of(row, "instance_token", table.path)
    if instance not in names:
        raise BadInput(
            f"{path.parent / 'instance.json'} has no row {shown(instance)}, which {path.name} names"
        )
    width, length, height = numbers_of(row, "size", 3, path).tolist()
    if not 0 < min(width, length, height) <= max(width, length, height) <= _MAX_M:
        raise BadInput(
            f"{path}: size of row {row_name(row)} is {width:g}, {length:g}, {height:g} m; copy it again"
        )
    tokens = row.get("attribute_tokens")
    given = (
        [attributes.get(token, "") for token in tokens if isinstance(token, str)]
        if isinstance(tokens, list)
        else []
    )
    has_count = row.get("num_lidar_pts") is not None
    pose = pose_of(row, path)
    return Annotation(
        instance=instance,
        class_name=names[instance],
        type=_type_of(names[instance], given),
        center_m=pose[:3, 3],
        size_lwh_m=np.array([length, width, height]),
        yaw_rad=float(yaw_of(pose)),
        num_points=int(number_of(row, "num_lidar_pts", path, most=1e9)) if has_count else -1,
    )


def _type_of(class_name: str, attributes: list[str]) -> int:
    """Return Waymo's number: a bicycle without a rider is nothing, and a motorcycle a vehicle."""
    by_prefix = (number for prefix, number in _PREFIXES.items() if class_name.startswith(prefix))
    number = _TYPES[class_name] if class_name in _TYPES else next(by_prefix, 0)
    return 0 if number == 4 and any(name.endswith(_NO_RIDER) for name in attributes) else number


def _frames_between(drive: NuScenesDrive, first: int, second: int) -> list[int]:
    return [frame.index for frame in drive.frames if first < frame.index < second]


def _share(drive: NuScenesDrive, first: int, second: int, frame: int) -> float:
    """Return how far a frame lies between two others, from 0 to 1."""
    start, end, here = (drive.sweeps[index].time_ns for index in (first, second, frame))
    return (here - start) / (end - start)


def _between(first: list[Annotation], second: list[Annotation], share: float) -> list[Annotation]:
    """Return the boxes of the objects that both key frames have: on a line, turned the short way."""
    later = {box.instance: box for box in second}
    boxes = []
    for box in first:
        other = later.get(box.instance)
        if other is not None:
            turn = float(wrap_angle(other.yaw_rad - box.yaw_rad))
            boxes.append(
                replace(
                    box,
                    center_m=box.center_m + share * (other.center_m - box.center_m),
                    size_lwh_m=box.size_lwh_m + share * (other.size_lwh_m - box.size_lwh_m),
                    yaw_rad=box.yaw_rad + share * turn,
                    num_points=-1,
                )
            )
    return boxes


def _in_ego_axes(boxes: list[Annotation], frame: int, drive: NuScenesDrive) -> Labels:
    """Return boxes of the world as labels of a frame."""
    step = [known.index for known in drive.frames].index(frame)
    poses = drive.world_from_ego
    assert poses is not None, "each frame of a scene has a pose"
    ego_from_world = inverse(poses[step])
    center_m = apply(ego_from_world, np.array([box.center_m for box in boxes]).reshape(-1, 3))
    far = np.flatnonzero(~(np.abs(center_m) <= _MAX_M).all(axis=1))
    if len(far):
        raise BadInput(
            f"{drive.name}: the box of {shown(boxes[far[0]].instance)} is more than {_MAX_M / 1000:g} km from the car "
            f"in frame {frame}; copy sample_annotation.json again"
        )
    world_from_box = from_yaw(np.array([box.yaw_rad for box in boxes]), np.zeros((len(boxes), 3)))
    heading = yaw_of(compose(ego_from_world, world_from_box)) if boxes else np.zeros(0)
    return Labels(
        center_m,
        np.array([box.size_lwh_m for box in boxes]).reshape(-1, 3),
        wrap_angle(heading),
        frame=np.full(len(boxes), frame),
        object_id=np.array([box.instance for box in boxes], dtype=str),
        class_name=np.array([box.class_name for box in boxes], dtype=str),
        type=np.array([box.type for box in boxes]),
        velocity_mps=np.full((len(boxes), 3), np.nan),
        num_points=np.array([box.num_points for box in boxes]),
        difficulty=np.zeros(len(boxes)),
    )


def _count_unknown(labels: Labels, drive: NuScenesDrive) -> Labels:
    """Return the labels with the points inside those that the data set does not count: all between key frames."""
    unknown = labels.num_points < 0
    if not unknown.any():
        return labels
    num_points = labels.num_points.copy()
    num_points[unknown] = count_points(labels[unknown], drive).num_points
    return replace(labels, num_points=num_points)
