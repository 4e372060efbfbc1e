"""nuScenes: the 13 tables in `v1.0-upvl/`, which its devkit opens as a data set of that version.

A frame is a sample, a track is an instance. Boxes are in the axes of the world.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.format import POINTS, TRACK, VELOCITY, ExportFormat, ExportOptions
from upvl_cli.export.frame_times import time_us
from upvl_cli.export.json_items import JsonItems
from upvl_cli.export.nuscenes_names import (
    ATTRIBUTES,
    CATEGORIES,
    VISIBILITIES,
    attributes_of,
    instance_token,
    token_of,
)
from upvl_cli.export.nuscenes_read import read
from upvl_cli.export.nuscenes_sensors import SensorFiles, ego_pose_token
from upvl_cli.export.world_axes import boxes_in_world, quaternions_wxyz
from upvl_cli.types import Array, Ints

VERSION = "v1.0-upvl"
_TABLES = (
    "category", "attribute", "visibility", "instance", "sensor", "calibrated_sensor", "ego_pose", "log", "scene",
    "sample", "sample_data", "sample_annotation", "map",
)  # fmt: skip
_MAP = "maps/empty.png"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write all tables, and with `with_data` the points and pictures that they name."""
    (folder / VERSION).mkdir()
    categories: set[str] = set()
    logs: list[str] = []
    with ExitStack() as files:
        tables = {name: files.enter_context(JsonItems(folder / VERSION / f"{name}.json")) for name in _TABLES}
        sensors = SensorFiles(folder, tables, with_data=options.with_data)
        for drive in drives:
            samples = [token_of("sample", drive.name, frame.index) for frame in drive.frames]
            logs.append(token_of("log", drive.name))
            _add_scene(drive, samples, tables)
            sensors.add(drive, samples, losses)
            classes = _track_classes(drive, losses)
            categories |= set(classes.values())
            _add_boxes(drive, samples, classes, tables)
        for name in sorted(categories):
            tables["category"].add({"token": token_of("category", name), "name": name, "description": ""})
        for name in ATTRIBUTES:
            tables["attribute"].add({"token": token_of("attribute", name), "name": name, "description": ""})
        for token, level in VISIBILITIES.items():
            tables["visibility"].add({"token": token, "level": level, "description": ""})
        tables["map"].add(
            {"token": token_of("map"), "log_tokens": logs, "category": "semantic_prior", "filename": _MAP}
        )
    _write_empty_map(folder / _MAP)


def _add_scene(drive: ExportDrive, samples: list[str], tables: dict[str, JsonItems]) -> None:
    scene, log = token_of("scene", drive.name), token_of("log", drive.name)
    start_us = time_us(drive.frames[0].time_ns) if drive.frames else 0
    tables["log"].add(
        {
            "token": log,
            "logfile": drive.name,
            "vehicle": "",
            "date_captured": str((_EPOCH + timedelta(microseconds=start_us)).date()),
            "location": "",
        }
    )
    tables["scene"].add(
        {
            "token": scene,
            "name": drive.name,
            "description": "",
            "log_token": log,
            "nbr_samples": len(samples),
            "first_sample_token": samples[0] if samples else "",
            "last_sample_token": samples[-1] if samples else "",
        }
    )
    rotations = quaternions_wxyz(drive.world_from_ego)
    for place, frame in enumerate(drive.frames):
        tables["sample"].add(
            {
                "token": samples[place],
                "timestamp": time_us(frame.time_ns),
                "scene_token": scene,
                "prev": samples[place - 1] if place else "",
                "next": samples[place + 1] if place + 1 < len(samples) else "",
            }
        )
        tables["ego_pose"].add(
            {
                "token": ego_pose_token(drive, frame),
                "timestamp": time_us(frame.time_ns),
                "rotation": rotations[place].tolist(),
                "translation": drive.world_from_ego[place, :3, 3].tolist(),
            }
        )


def _track_classes(drive: ExportDrive, losses: Losses) -> dict[int, str]:
    """Return the class of each track: that of most of its boxes, as an instance has one category."""
    counts: dict[int, Counter[str]] = {}
    for track, name in zip(drive.boxes.track_id.tolist(), drive.boxes.class_name.tolist(), strict=True):
        counts.setdefault(track, Counter())[name] += 1
    classes = {
        track: min(count, key=lambda name: (-count[name], name)) for track, count in sorted(counts.items())
    }
    losses["boxes of another class than most boxes of their track: written in that of the track"] += sum(
        count.total() - count[classes[track]] for track, count in counts.items()
    )
    return classes


def _add_boxes(
    drive: ExportDrive, samples: list[str], classes: dict[int, str], tables: dict[str, JsonItems]
) -> None:
    boxes, places = drive.boxes, drive.places
    tokens = [
        token_of("annotation", drive.name, frame, track)
        for frame, track in zip(boxes.frame.tolist(), boxes.track_id.tolist(), strict=True)
    ]
    before, after = _neighbors(boxes.track_id)
    center_m, wxyz = boxes_in_world(drive)
    velocity = drive.velocity_world_mps()
    attributes = attributes_of(drive, [classes[track] for track in boxes.track_id.tolist()])
    for i, track in enumerate(boxes.track_id.tolist()):
        tables["sample_annotation"].add(
            {
                "token": tokens[i],
                "sample_token": samples[places[i]],
                "instance_token": instance_token(drive.name, track),
                "visibility_token": "",
                "attribute_tokens": [token_of("attribute", attributes[i])] if attributes[i] else [],
                "translation": center_m[i].tolist(),
                "size": boxes.size_lwh_m[i, [1, 0, 2]].tolist(),
                "rotation": wxyz[i].tolist(),
                "prev": tokens[before[i]] if before[i] >= 0 else "",
                "next": tokens[after[i]] if after[i] >= 0 else "",
                "num_lidar_pts": int(boxes.num_points[i]),
                "num_radar_pts": 0,
                # As in TIER IV's T4; the devkit of nuScenes derives its own from the places of the boxes.
                "velocity": velocity[i].tolist() if np.isfinite(velocity[i]).all() else None,
            }
        )
    tracks: dict[int, list[str]] = {}
    for track, token in zip(boxes.track_id.tolist(), tokens, strict=True):
        tracks.setdefault(track, []).append(token)
    for track, name in classes.items():
        tables["instance"].add(
            {
                "token": instance_token(drive.name, track),
                "category_token": token_of("category", name),
                "nbr_annotations": len(tracks[track]),
                "first_annotation_token": tracks[track][0],
                "last_annotation_token": tracks[track][-1],
            }
        )


def _neighbors(track_id: Array) -> tuple[Ints, Ints]:
    """Return (n,) the box before and the box after each of the same track, -1 where there is none."""
    order = np.argsort(track_id, kind="stable")
    same = track_id[order[1:]] == track_id[order[:-1]]
    before, after = np.full(len(order), -1), np.full(len(order), -1)
    before[order[1:][same]] = order[:-1][same]
    after[order[:-1][same]] = order[1:][same]
    return before, after


def _write_empty_map(path: Path) -> None:
    """Write the picture of a map without a road: the devkit opens no data set without one."""
    from PIL import Image

    path.parent.mkdir()
    Image.new("L", (8, 8)).save(path)


FORMAT = ExportFormat(
    "nuscenes", write, read, frozenset({TRACK, POINTS, VELOCITY}), CATEGORIES, fixed_classes=True
)
