"""What the page of one hit shows: its track over time, its properties, and which cameras see it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from markupsafe import Markup

from upvl_cli.drawing.hit_sheet import part_with_box
from upvl_cli.errors import BadSetting
from upvl_cli.types import Camera, Ints, TrackedBoxes
from upvl_cli.web.answer import Answer
from upvl_cli.web.catalog import Catalog
from upvl_cli.web.charts import lines
from upvl_cli.web.parameters import Asked, encode
from upvl_cli.web.pictures import boxes_at
from upvl_cli.web.raw_drives import RawDrives
from upvl_cli.web.results_page import version, votes


def track_rows(catalog: Catalog, segment: str, row: int) -> Ints:
    """Return the rows of all boxes of the track of a box, by time; a box without a track is alone."""
    track_id = catalog.objects(segment).track_id
    return np.flatnonzero(track_id == track_id[row]) if track_id[row] >= 0 else np.array([row])


def hit_page(
    catalog: Catalog, drives: RawDrives, place: tuple[str, int, int], asked: Asked, answer: Answer | None
) -> dict[str, Any]:
    """Return what the page shows.

    Args:
        catalog: The boxes.
        drives: The raw drives, for the cameras.
        place: Drive, frame and row of the box.
        asked: The question that found it, and the frame to show.
        answer: The answer to it; None where there was none.

    Raises:
        BadSetting: There is no such box.
    """
    segment, frame, box = place
    objects, row = catalog.objects(segment), catalog.row(segment, frame, box)
    rows = track_rows(catalog, segment, row)
    track, names = objects[rows], catalog.names(segment)
    frames = np.unique(objects.frame)
    at = int(frames[np.abs(frames - (frame if asked.at is None else asked.at)).argmin()])
    at_s = float(objects.time_s[np.searchsorted(objects.frame, at)])
    shown = rows[track.frame == at]
    speed = track.speed_mps
    source = catalog.source
    shown_votes = votes(catalog, answer, segment, frame, box) if answer else ()
    voted = next((vote.word for vote in shown_votes), "object")
    return {
        "title": str(names.word[row] or names.class_name[row] or voted),
        "place": f"{source}/{segment}/{frame}/{box}",
        "segment": segment,
        "source": source,
        "frame": frame,
        "box": box,
        "track": int(objects.track_id[row]),
        "at": at,
        "at_s": at_s,
        "frames": frames.tolist(),
        "track_frames": track.frame.tolist(),
        "in_frame": bool(len(shown)),
        "facts": _facts(catalog, segment, row, rows),
        "chart": Markup(lines(track.time_s, speed, at_s, "m/s", "Speed of the track over time")),
        "votes": shown_votes,
        "cameras": cameras_at(catalog, drives, segment, at, int(shown[0]) if len(shown) else None),
        "back": encode(replace(asked, at=None)),
        "fields": parse_qsl(encode(replace(asked, at=None))),
        "version": version(catalog),
        "similar": encode(
            Asked(replace(type(asked.question)(), source=source, similar_to=(segment, frame, box)))
        ),
        "can_compare": bool(objects.num_features[row] > 0 or objects.num_looks[row] > 0),
        "steps": _steps(asked, frames, at),
    }


def _steps(asked: Asked, frames: Ints, at: int) -> dict[str, str]:
    """Return the queries of the frames before and after the present one; empty at the ends."""
    place = int(np.searchsorted(frames, at))
    before = encode(replace(asked, at=int(frames[place - 1]))) if place else ""
    after = encode(replace(asked, at=int(frames[place + 1]))) if place + 1 < len(frames) else ""
    return {"before": before, "after": after}


def _facts(catalog: Catalog, segment: str, row: int, rows: Ints) -> list[tuple[str, str]]:
    objects, names = catalog.objects(segment), catalog.names(segment)
    track = objects[rows]
    length, width, height = (float(value) for value in objects.size_lwh_m[row])
    span_s = float(track.time_s[-1] - track.time_s[0])
    facts = [
        ("Class", str(names.class_name[row])),
        ("Word", str(names.word[row])),
        ("Score of the box", f"{objects.confidence[row]:.2f}"),
        ("Size (l × w × h)", f"{length:.2f} × {width:.2f} × {height:.2f} m"),
        ("Distance", f"{objects.range_m[row]:.1f} m"),
        ("Speed", f"{objects.speed_mps[row]:.1f} m/s (fastest {track.speed_mps.max():.1f} m/s)"),
        ("Boxes of the track", f"{len(rows)} in {span_s:.1f} s"),
        ("Points with a feature", str(int(objects.num_features[row]))),
        ("Pictures looked at", str(int(objects.num_looks[row]))),
    ]
    return [(name, text) for name, text in facts if text]


def cameras_at(
    catalog: Catalog, drives: RawDrives, segment: str, frame: int, row: int | None
) -> list[dict[str, Any]]:
    """Return number, name and whether it sees a box, of each camera, those first that see it.

    Args:
        catalog: The boxes.
        drives: The raw drives.
        segment: Name of the drive.
        frame: Index of the frame.
        row: Row of the box among those of the drive; None where the track has none in the frame.
    """
    box: TrackedBoxes | None = None
    if row is not None:
        boxes = boxes_at(catalog, segment, frame)
        number = int(catalog.objects(segment).box[row])
        box = boxes[number : number + 1]
    cameras = [
        {"number": number, "name": camera.name, "sees": box is not None and _sees(camera, box)}
        for number, camera in enumerate(drives.cameras(segment))
    ]
    return sorted(cameras, key=lambda camera: not camera["sees"])


def _sees(camera: Camera, box: TrackedBoxes) -> bool:
    return part_with_box(camera, box) is not None


def track_json(catalog: Catalog, segment: str, track: int) -> dict[str, Any]:
    """Return a track over time as JSON has it.

    Raises:
        BadSetting: The drive has no such track.
    """
    objects = catalog.objects(segment)
    rows = np.flatnonzero(objects.track_id == track)
    if track < 0 or not len(rows):
        raise BadSetting(f"drive {segment} has no track {track} among the {catalog.source}")
    boxes = objects[rows]
    return {
        "frame": boxes.frame.tolist(),
        "time_s": [round(value, 3) for value in boxes.time_s.tolist()],
        "speed_mps": [round(value, 3) for value in boxes.speed_mps.tolist()],
        "score": [round(value, 3) for value in boxes.confidence.tolist()],
    }
