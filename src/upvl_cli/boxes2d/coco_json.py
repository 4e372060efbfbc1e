"""Boxes in the JSON of COCO: images, annotations and categories."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from upvl_cli.boxes2d.stored import StoredBoxes
from upvl_cli.errors import BadInput, one_line

_KEYS = ("segment", "frame", "camera")
_TABLES = ("images", "annotations", "categories")
_MAX_FRAME_DIGITS = 18  # more do not fit 64 bits


def read_coco(path: Path) -> StoredBoxes:
    """Return all boxes of a file.

    Raises:
        BadInput: The file is none, or something in it is of another form.
    """
    content = _read(path)
    keys = {
        _identity(image, "id", f"{path}: images[{row}]"): _picture_key(image, f"{path}: images[{row}]")
        for row, image in enumerate(content["images"])
    }
    names = {
        _identity(category, "id", f"{path}: categories[{row}]"): _text(
            category, "name", f"{path}: categories[{row}]"
        )
        for row, category in enumerate(content["categories"])
    }
    rows: list[tuple[str, int, str]] = []
    edges, scores, kinds = [], [], []
    for row, annotation in enumerate(content["annotations"]):
        where = f"{path}: annotations[{row}]"
        rows.append(_lookup(keys, annotation, "image_id", where))
        kinds.append(_lookup(names, annotation, "category_id", where))
        edges.append(_edges(annotation, where))
        scores.append(_number(annotation.get("score", 1.0), f"{where}: score"))
    segments, frames, cameras = zip(*rows, strict=True) if rows else ((), (), ())
    return StoredBoxes(
        segment=np.array(segments, dtype=np.str_),
        frame=np.array(frames, dtype=np.int64),
        camera=np.array(cameras, dtype=np.str_),
        edges_px=np.array(edges),
        score=np.array(scores),
        name=np.array(kinds, dtype=np.str_),
    )


def _read(path: Path) -> dict[str, list[dict[str, Any]]]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read as JSON ({one_line(error)})") from error
    if not isinstance(content, dict):
        raise BadInput(
            f"{path}: holds a {type(content).__name__}, expected an object with {', '.join(_TABLES)}: results "
            "alone do not name their pictures; add the images and categories that they belong to"
        )
    for name in _TABLES:
        rows = content.get(name)
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise BadInput(f"{path}: {name} is {_shown(rows)}, expected a list of objects")
    return content


def _picture_key(image: Mapping[str, Any], where: str) -> tuple[str, int, str]:
    """Return segment, frame and camera of a picture: by keys of these names, else by its file name."""
    given = [key for key in _KEYS if key in image]
    if len(given) == len(_KEYS):
        frame = image["frame"]
        if not isinstance(frame, int) or isinstance(frame, bool) or abs(frame) >= 10**_MAX_FRAME_DIGITS:
            raise BadInput(f"{where}: frame is {_shown(frame)}, expected a whole number")
        return _text(image, "segment", where), frame, _text(image, "camera", where)
    if given:
        raise BadInput(
            f"{where}: has {', '.join(given)} alone, expected all of {', '.join(_KEYS)}, or file_name"
        )
    parts = PurePosixPath(_text(image, "file_name", where).replace("\\", "/")).parts
    stem = PurePosixPath(parts[-1]).stem if parts else ""
    if len(parts) < 3 or not (stem.isascii() and stem.isdigit() and len(stem) <= _MAX_FRAME_DIGITS):
        raise BadInput(
            f"{where}: file_name is {_shown(image['file_name'])}, expected SEGMENT/CAMERA/FRAME.jpg with the number "
            f"of the frame, or keys {', '.join(_KEYS)}"
        )
    return parts[-3], int(stem), parts[-2]


def _edges(annotation: Mapping[str, Any], where: str) -> list[float]:
    box = annotation.get("bbox")
    if not isinstance(box, list) or len(box) != 4:
        raise BadInput(f"{where}: bbox is {_shown(box)}, expected [x, y, width, height] in pixels")
    x, y, width, height = (_number(value, f"{where}: bbox") for value in box)
    return [x, y, x + width, y + height]


def _number(value: Any, where: str) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise BadInput(f"{where} has {_shown(value)}, expected a finite number")
    return float(value)


def _text(item: Mapping[str, Any], key: str, where: str) -> str:
    value = item.get(key)
    if not isinstance(value, str) or not value:
        raise BadInput(f"{where}: {key} is {_shown(value)}, expected a text")
    return value


def _identity(item: Mapping[str, Any], key: str, where: str) -> int | str:
    value = item.get(key)
    if not isinstance(value, (int, str)) or isinstance(value, bool):
        raise BadInput(f"{where}: {key} is {_shown(value)}, expected a number or a text")
    return value


def _lookup(known: Mapping[int | str, Any], item: Mapping[str, Any], key: str, where: str) -> Any:
    identity = _identity(item, key, where)
    if identity not in known:
        raise BadInput(f"{where}: {key} is {_shown(identity)}, which none of the file's entries has as id")
    return known[identity]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
