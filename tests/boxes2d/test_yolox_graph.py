"""A detector in an ONNX graph: a real tiny graph, pictures with a square, and damaged files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="makes the graphs of these tests")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")

from onnx import TensorProto
from PIL import Image
from tiny_yolox import NAMES, SIDE, write_graph

from upvl_cli.boxes2d import box_source_family
from upvl_cli.boxes2d.base import CameraPicture
from upvl_cli.boxes2d.config import SuppressionConfig
from upvl_cli.boxes2d.onnx import YoloxDetector, files, read_card
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.types import Boxes2d

CONFIG = SuppressionConfig(tile_scales=(1.0,), tile_overlap=0.25, max_iou=0.5)
CARD = f"names = {list(NAMES)}\n"


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    (tmp_path / "tiny.toml").write_text(CARD)
    return write_graph(tmp_path / "tiny.onnx")


def boxes_in(path: Path, rgb: np.ndarray) -> Boxes2d:
    return YoloxDetector(str(path), CONFIG).boxes(CameraPicture(0, "front", rgb))


def test_a_blue_square_is_a_box_in_the_pixels_of_the_picture(graph: Path) -> None:
    rgb = np.zeros((SIDE, 160, 3), np.uint8)
    rgb[16:24, 104:112] = [10, 20, 204]  # of the last native tile, which begins at 96, one cell
    found = boxes_in(graph, rgb)
    best = found[found.score > 0.5]
    np.testing.assert_allclose(best.xyxy_px, [[103.5, 15.5, 111.5, 23.5]], atol=1e-4)
    np.testing.assert_allclose(best.score, [0.8], atol=1e-6)
    assert best.name.tolist() == ["square"]


def test_a_picture_without_blue_has_no_box(graph: Path) -> None:
    assert len(boxes_in(graph, np.full((SIDE, SIDE, 3), [255, 255, 0], np.uint8))) == 0


def test_boxes_end_at_the_border_of_the_picture(graph: Path) -> None:
    found = boxes_in(graph, np.full((60, 60, 3), [0, 0, 255], np.uint8))
    assert len(found) and found.xyxy_px.min() >= -0.5 and found.xyxy_px.max() <= 59.5


def test_boxes_in_pixels_are_said_by_the_card(graph: Path) -> None:
    graph.with_suffix(".toml").write_text(f"{CARD}decoded = true\n")
    write_graph(graph, values=19.5)  # centre and size 20 and 19.5 px in each cell
    rgb = np.zeros((SIDE, SIDE, 3), np.uint8)
    rgb[8:16, :8, 2] = 255
    found = boxes_in(graph, rgb)
    np.testing.assert_allclose(
        found.xyxy_px[0], [10.25 - 0.5, 10.25 - 0.5, 29.75 - 0.5, 29.75 - 0.5], atol=1e-4
    )


def test_without_a_card_the_kinds_are_those_of_coco(tmp_path: Path) -> None:
    path = write_graph(tmp_path / "coco.onnx", names=80)
    assert read_card(tmp_path / "coco.toml")[0][:3] == ("person", "bicycle", "car")
    found = boxes_in(path, np.full((SIDE, SIDE, 3), 255, np.uint8))
    assert set(found.name.tolist()) == {"person"}


def test_the_files_that_make_the_boxes_are_graph_card_and_weights(graph: Path) -> None:
    graph.with_name("tiny.onnx.data").write_bytes(b"weights beside the graph")
    graph.with_name("README.md").write_text("not the model")
    assert [path.name for path in files(str(graph))] == ["tiny.onnx", "tiny.toml", "tiny.onnx.data"]


def card(text: str) -> Callable[[Path], Any]:
    return lambda path: path.with_suffix(".toml").write_text(text)


BAD: list[tuple[Callable[[Path], Any], str]] = [
    (lambda path: path.write_bytes(b"no graph"), "onnxruntime cannot read it"),
    (lambda path: path.write_bytes(path.read_bytes()[:200]), "onnxruntime cannot read it"),
    (lambda path: write_graph(path, outputs=2), "and 2 outputs, expected one input"),
    (lambda path: write_graph(path, size=(1, 3, "h", "w")), "with fixed sides that are multiples of 32"),
    (
        lambda path: write_graph(path, size=(1, 3, 60, 60), cells=84),
        "with fixed sides that are multiples of 32",
    ),
    (lambda path: write_graph(path, size=(1, 1, SIDE, SIDE)), "expected one input"),
    (lambda path: write_graph(path, names=5), r"gives shape \(1, 84, 10\), expected \(1, 84, 7\)"),
    (lambda path: write_graph(path, cells=80), r"gives shape \(1, 80, 7\), expected \(1, 84, 7\)"),
    (lambda path: write_graph(path, values=float("nan")), "gives numbers that are not finite"),
    (card("names = 'person'"), "'names' is 'person', expected a list of words"),
    (card("names = []"), "expected a list of words"),
    (card("decoded = 1"), "'decoded' is 1, expected true or false"),
    (card("name = ['a', 'b']"), r"unknown key 'name' \(known keys: names, decoded\)"),
    (card("names = ["), "cannot be read as TOML"),
    (lambda path: path.unlink(), "expected the file of an ONNX graph"),
]


@pytest.mark.parametrize(("spoil", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_a_bad_file_is_one_clear_line(graph: Path, spoil: Callable[[Path], Any], message: str) -> None:
    spoil(graph)
    with pytest.raises(BadInput, match=message) as failure:
        boxes_in(graph, np.full((SIDE, SIDE, 3), 255, np.uint8))
    assert "\n" not in str(failure.value) and str(graph.parent) in str(failure.value)


def test_onnxruntime_that_is_not_installed_is_named(graph: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # Python's own mark of what cannot be imported
    with pytest.raises(BadSetting, match=r"pip install 'upvl\[onnx\]'"):
        boxes_in(graph, np.zeros((SIDE, SIDE, 3), np.uint8))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("onx:/a.onnx", "unknown source 'onx'; did you mean 'onnx'"),
        ("nono", "did you mean 'none'"),
        ("/a.onnx", r"\(for example: 'none', 'onnx:"),
    ],
)
def test_an_unknown_source_lists_the_known_ones(value: str, message: str) -> None:
    with pytest.raises(BadSetting, match=message):
        box_source_family(value)


def test_a_graph_takes_floats_alone(graph: Path) -> None:
    write_graph(graph, kind=TensorProto.DOUBLE)
    with pytest.raises(BadInput):
        boxes_in(graph, np.zeros((SIDE, SIDE, 3), np.uint8))


@pytest.mark.real
def test_a_real_detector_finds_the_cyclists_of_a_real_picture(shared: Path) -> None:
    """Frame 70 shows a rider at the right, another person before a wall, and a car at the left edge."""
    drive = shared / "data/kitti_raw_b/2011_09_26/2011_09_26_drive_0001_sync/image_02/data"
    rgb = np.asarray(Image.open(drive / "0000000070.png").convert("RGB"))
    found = boxes_in(shared / "data/models/yolox_nano.onnx", rgb)
    people = found[(found.name == "person") & (found.score > 0.4)]
    middles = (people.xyxy_px[:, :2] + people.xyxy_px[:, 2:]) / 2
    assert sorted(np.round(middles[:, 0], -1).tolist()) == [810.0, 1030.0]
    car = found[(found.name == "car") & (found.score > 0.8)]
    np.testing.assert_allclose(car.xyxy_px, [[-0.5, 202, 172, 306]], atol=6)
