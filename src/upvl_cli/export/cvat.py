"""CVAT, "Kitti Raw Format 1.0": `<drive>/tracklet_labels.xml`, `<drive>/frame_list.txt`, points as PCD beside them.

What CVAT reads is not what KITTI wrote (formats/velodynepoint.py of CVAT; kitti_raw_format/extractor.py and
converter.py of the datumaro it uses): places are centres, not bottoms, and `w`, `h`, `l` are the sizes along the
box's x, y and z. Frames count from 0 in the order of their names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np

from upvl_cli.errors import BadInput, one_line
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.sweeps import write_picture, write_points_pcd
from upvl_cli.export.text import read_text
from upvl_cli.export.tool_files import (
    NUMBERS,
    FoundBoxes,
    drive_folders,
    frame_name,
    frame_of_name,
    numbers_beside,
)

_TRACKLETS, _FRAMES = "tracklet_labels.xml", "frame_list.txt"
_MOST_BYTES = 256 * 2**20  # a pose takes some 700 bytes: more boxes than any drive has
_NO_BOX = (2, 99)  # truncation of a pose that is outside: the object is not there
_HEAD = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<!DOCTYPE boost_serialization>
<boost_serialization version="9" signature="serialization::archive">
<tracklets version="0" tracking_level="0" class_id="0">"""
# Nobody said what is occluded (-1), the pose is labelled (2), and inside of what the sensor sees (0).
_POSE_END = (
    "<state>2</state><occlusion>-1</occlusion><occlusion_kf>0</occlusion_kf><truncation>0</truncation>"
    "<amt_occlusion>-1</amt_occlusion><amt_border_l>-1</amt_border_l><amt_border_r>-1</amt_border_r>"
    "<amt_occlusion_kf>-1</amt_occlusion_kf><amt_border_kf>-1</amt_border_kf>"
)


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one folder a drive."""
    for drive in drives:
        own = folder / drive.name
        own.mkdir()
        lines = [f"{place} {frame_name(frame.index)}\n" for place, frame in enumerate(drive.frames)]
        (own / _FRAMES).write_text("".join(lines), encoding="utf-8")
        tracklets = [_tracklet(part, first) for first, part in _unchanging_runs(drive)]
        body = [_HEAD, f"<count>{len(tracklets)}</count><item_version>1</item_version>", *tracklets]
        text = "\n".join([*body, "</tracklets>", "</boost_serialization>", ""])
        (own / _TRACKLETS).write_text(text, encoding="utf-8")
        for frame in drive.frames if options.with_data else ():
            name = frame_name(frame.index)
            write_points_pcd(drive, frame.index, own / "velodyne_points" / "data" / f"{name}.pcd")
            for number, camera in enumerate(drive.cameras):
                write_picture(
                    drive, frame.index, camera, own / f"image_{number:02d}" / "data" / f"{name}.png"
                )


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all folders of drives."""
    return {name: _read_drive(own, drive) for name, own, drive in drive_folders(folder, drives, _TRACKLETS)}


def _unchanging_runs(drive: ExportDrive) -> Iterator[tuple[int, ExportBoxes]]:
    """Yield the place of the first frame and the boxes of each part of a track.

    A tracklet has one size, one class and a pose for each of its frames; where a track changes or pauses, another
    begins.
    """
    boxes = drive.boxes[np.lexsort([drive.boxes.frame, drive.boxes.track_id])]
    places = drive.places_of(boxes.frame)
    is_new = np.ones(len(boxes), dtype=np.bool_)
    if len(boxes) > 1:
        is_new[1:] = (np.diff(boxes.track_id) != 0) | (np.diff(places) != 1)
        is_new[1:] |= (np.diff(boxes.size_lwh_m, axis=0) != 0).any(axis=1)
        is_new[1:] |= boxes.class_name[1:] != boxes.class_name[:-1]
    starts = np.flatnonzero(is_new)
    for start, end in pairwise([*starts, len(boxes)]):
        yield int(places[start]), boxes[start:end]


def _tracklet(boxes: ExportBoxes, first: int) -> str:
    length, width, height = (repr(float(value)) for value in boxes.size_lwh_m[0])
    poses = "".join(f"\n  <item>{_pose(boxes, i)}</item>" for i in range(len(boxes)))
    return (
        f"<item><objectType>{escape(str(boxes.class_name[0]))}</objectType>"
        f"<h>{width}</h><w>{length}</w><l>{height}</l><first_frame>{first}</first_frame>"
        f"<poses><count>{len(boxes)}</count><item_version>2</item_version>{poses}</poses>"
        f"<finished>1</finished>{_attributes({'track_id': int(boxes.track_id[0])})}</item>"
    )


def _pose(boxes: ExportBoxes, i: int) -> str:
    values = zip(("tx", "ty", "tz"), boxes.center_m[i], strict=True)
    place = "".join(f"<{tag}>{float(value)!r}</{tag}>" for tag, value in values)
    turn = f"<rx>0.0</rx><ry>0.0</ry><rz>{float(boxes.heading_rad[i])!r}</rz>"
    return f"{place}{turn}{_POSE_END}{_attributes(numbers_beside(boxes, i))}"


def _attributes(values: Mapping[str, float]) -> str:
    entries = [
        f"<attribute><name>{name}</name><value>{value!r}</value></attribute>"
        for name, value in values.items()
    ]
    return f"<attributes>{''.join(entries)}</attributes>"


def _read_drive(folder: Path, drive: ExportDrive) -> ExportBoxes:
    path = folder / _TRACKLETS
    frames, found = _frame_numbers(folder / _FRAMES, drive), FoundBoxes()
    for number, item in enumerate(_root(path).findall("tracklets/item")):
        where = f"{path}, tracklet {number}"
        name = (item.findtext("objectType") or "").strip()
        if not name:
            raise BadInput(f"{where} has no objectType; expected a class")
        size = [_number(item, tag, where) for tag in ("w", "h", "l")]
        first = int(_number(item, "first_frame", where))
        track = _values(item).get("track_id", f"tracklet {number}")
        for offset, pose in enumerate(item.findall("poses/item")):
            at = f"{where}, pose {offset}"
            truncation = pose.findtext("truncation")
            if truncation is not None and int(_number(pose, "truncation", at)) in _NO_BOX:
                continue
            if first + offset not in frames:
                raise BadInput(f"{at} is of frame {first + offset}; {_FRAMES} has none of that number")
            place = [_number(pose, tag, at) for tag in ("tx", "ty", "tz")]
            heading = _number(pose, "rz", at)
            numbers = {
                key: JsonValue(text, at).number() for key, text in _values(pose).items() if key in NUMBERS
            }
            found.add(frames[first + offset], track, name, [*place, *size, heading], numbers)
    return found.boxes()


def _values(element: ElementTree.Element) -> dict[str, str]:
    """Return what the attributes of a tracklet or a pose say; empty ones are as if they were not there."""
    entries = element.findall("attributes/attribute")
    pairs = ((entry.findtext("name") or "", (entry.findtext("value") or "").strip()) for entry in entries)
    return {name: value for name, value in pairs if name and value}


def _frame_numbers(path: Path, drive: ExportDrive) -> dict[int, int]:
    """Return the index of the frame by its number in the file; without a list, frames count from 0."""
    if not path.is_file():
        return {place: frame.index for place, frame in enumerate(drive.frames)}
    numbers = {}
    for line, text in enumerate(read_text(path).splitlines(), start=1):
        words = text.split(maxsplit=1)
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {line}"
        if len(words) != 2:
            raise BadInput(f"{where} is {text[:40]!r}; expected a number and the name of a frame")
        name = words[1].strip().replace("\\", "/").rpartition("/")[2].removesuffix(".pcd")
        numbers[frame_of_name(words[0], where)] = frame_of_name(name, where)
    return numbers


def _root(path: Path) -> ElementTree.Element:
    if path.is_file() and path.stat().st_size > _MOST_BYTES:
        raise BadInput(f"{path} is larger than {_MOST_BYTES >> 20} MiB; expected tracklets")
    text = read_text(path)
    # Entities can grow a small text without bound. CVAT writes a DOCTYPE, but one that declares nothing.
    if "<!ENTITY" in text or "[" in text.partition("<!DOCTYPE")[2].partition(">")[0]:
        raise BadInput(f"{path} declares XML entities, which no tool needs here; export it again")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise BadInput(f"{path} is not whole XML ({one_line(error)}); export it again") from None


def _number(element: ElementTree.Element, tag: str, where: str) -> float:
    text = element.findtext(tag)
    if text is None:
        raise BadInput(f"{where} has no {tag}; expected a number")
    return JsonValue(text, f"{where}, {tag}").number()


CVAT_STEP = 0.01  # datumaro, which CVAT reads and writes with, keeps two decimals of every number of a cuboid
FORMAT = ExportFormat("cvat", write, read, tool_step=CVAT_STEP)
