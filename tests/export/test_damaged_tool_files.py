"""Files of annotation tools that are damaged or foreign: one clear line, never another error."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import drive_of_one_car, read, write
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes

TOOLS = ("openlabel", "cvat", "supervisely", "xtreme1", "sustechpoints", "segments-ai")
# What stands in a file of JSON where something else was expected.
STRANGE: tuple[Any, ...] = (
    None, True, "", "text", "nan", -1, 0, 10**400, 1e308, [], {}, [1, 2], {"x": 1}, float("nan"), "../../x", 2**70,
)  # fmt: skip


def boxes_or_refusal(name: str, folder: Path) -> ExportBoxes | str:
    """What is read; the message where it is refused. Anything else fails the test."""
    try:
        boxes = read(name, folder, labelled_drive(frames=2))
    except BadInput as error:
        assert "\n" not in str(error)
        return str(error)
    assert np.isfinite(boxes.to_rows()).all() and (boxes.size_lwh_m > 0).all()
    return boxes


def export_of(name: str, folder: Path) -> list[Path]:
    """The files of an export that the reader reads, apart from the manifest."""
    write(labelled_drive(frames=2), name, folder)
    (folder / "upvl.json").unlink()
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", TOOLS)
def test_files_that_are_cut_off_or_flipped(name: str, tmp_path: Path) -> None:
    draw = random.Random(0)
    paths, refused = export_of(name, tmp_path / "out"), 0
    for path in paths:
        content = path.read_bytes()
        for trial in range(16):
            damaged = bytearray(content)
            if trial < 6:
                damaged = damaged[: draw.randrange(len(content))]
            else:
                for _ in range(draw.choice((1, 3, 20))):
                    damaged[draw.randrange(len(damaged))] = draw.randrange(256)
            path.write_bytes(bytes(damaged))
            refused += isinstance(boxes_or_refusal(name, tmp_path / "out"), str)
        path.write_bytes(content)
    assert refused > 10


def places(content: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values."""
    yield way
    items = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in items:
        yield from places(value, (*way, key))


def put(content: Any, way: tuple[Any, ...], value: Any) -> Any:
    """The content with another value at a place; a place that is dropped has no member."""
    if not way:
        return value
    if isinstance(content, dict):
        return {key: put(old, way[1:], value) if key == way[0] else old for key, old in content.items()}
    return [put(old, way[1:], value) if key == way[0] else old for key, old in enumerate(content)]


@pytest.mark.parametrize("name", [name for name in TOOLS if name != "cvat"])
def test_values_of_other_types(name: str, tmp_path: Path) -> None:
    draw, refused = random.Random(1), 0
    for path in export_of(name, tmp_path / "out"):
        original = path.read_text()
        content = json.loads(original)
        ways = list(places(content))
        for way in draw.sample(ways, min(len(ways), 16)):
            for value in draw.sample(STRANGE, 2):
                path.write_text(json.dumps(put(content, way, value)))
                refused += isinstance(boxes_or_refusal(name, tmp_path / "out"), str)
        path.write_text(original)
    assert refused > 5


@pytest.mark.parametrize("name", [name for name in TOOLS if name != "cvat"])
def test_members_that_are_missing(name: str, tmp_path: Path) -> None:
    for path in export_of(name, tmp_path / "out"):
        original = path.read_text()
        content = json.loads(original)
        for way in [way for way in places(content) if way and isinstance(way[-1], str)][::3][:40]:
            path.write_text(json.dumps(without(content, way)))
            boxes_or_refusal(name, tmp_path / "out")
        path.write_text(original)


def without(content: Any, way: tuple[Any, ...]) -> Any:
    if len(way) == 1:
        return {key: value for key, value in content.items() if key != way[0]}
    if isinstance(content, dict):
        return {key: without(old, way[1:]) if key == way[0] else old for key, old in content.items()}
    return [without(old, way[1:]) if key == way[0] else old for key, old in enumerate(content)]


@pytest.mark.parametrize("name", TOOLS)
def test_files_of_something_else(name: str, tmp_path: Path) -> None:
    for number, strange in enumerate(
        (b"", b"[]", b"{}", b"\x89PNG\r\n", b"<a/>", b"[" * 100_000, b'"\\ud800"')
    ):
        folder = tmp_path / str(number)
        for path in export_of(name, folder):
            path.write_bytes(strange)
        boxes_or_refusal(name, folder)


@pytest.mark.parametrize("name", TOOLS)
def test_folders_in_the_place_of_files(name: str, tmp_path: Path) -> None:
    for number, path in enumerate(export_of(name, tmp_path / "out")):
        shutil.copytree(tmp_path / "out", tmp_path / str(number))
        other = tmp_path / str(number) / path.relative_to(tmp_path / "out")
        other.unlink()
        other.mkdir()
        boxes_or_refusal(name, tmp_path / str(number))


@pytest.mark.parametrize("name", TOOLS)
def test_a_folder_without_labels_of_the_drive_is_named(name: str, tmp_path: Path) -> None:
    write(drive_of_one_car("another"), name, tmp_path / "out")
    (tmp_path / "out" / "upvl.json").unlink()
    assert "has no labels of a drive of this workspace (bend-1)" in str(
        boxes_or_refusal(name, tmp_path / "out")
    )


@pytest.mark.parametrize("name", TOOLS)
def test_two_boxes_of_a_track_in_a_frame_are_refused(name: str, tmp_path: Path) -> None:
    write(drive_of_one_car(), name, tmp_path / "out")
    twice = {
        "openlabel": lambda o: o["openlabel"]["frames"]["7"]["objects"]["12"]["object_data"]["cuboid"],
        "supervisely": lambda o: o["figures"],
        "xtreme1": lambda o: o["objects"],
        "sustechpoints": lambda o: o,
        "segments-ai": lambda o: o["frames"][0]["annotations"],
    }
    if name == "cvat":
        path = tmp_path / "out" / "one" / "tracklet_labels.xml"
        item = path.read_text().partition("<item>")[2].rpartition("</item>")[0]
        path.write_text(path.read_text().replace("</tracklets>", f"<item>{item}</item></tracklets>"))
    else:
        patterns = {"openlabel": "*.openlabel.json", "segments-ai": "*.label.json"}
        (path,) = (tmp_path / "out").rglob(patterns.get(name, "0000000007*.json"))
        content = json.loads(path.read_text())
        entries = twice[name](content)
        entries.append(entries[0])
        path.write_text(json.dumps(content))
    with pytest.raises(BadInput, match="frame 7 of one has two boxes of track 12; expected one"):
        read(name, tmp_path / "out", drive_of_one_car())
