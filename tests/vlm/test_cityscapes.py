"""The Cityscapes adapter: graphs whose classes are known functions of a picture's colours."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnx", reason="makes the graphs of these tests")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")

from onnx import TensorProto, helper
from tiny_graph import graph

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.perception.visual.open_vocabulary import background_score
from upvl_cli.vlm import model_family
from upvl_cli.vlm.cityscapes import CLASSES, WORDS_OF, Cityscapes, files, resized_size
from upvl_cli.vlm.mini import OBJECTS, Mini

NAMES = list(WORDS_OF)
CARD = {
    "mean": [0.5, 0.5, 0.5],
    "std": [0.5, 0.5, 0.5],
    "multiple": 8,
    "channels": "rgb",
    "longer_side_px": 32,
}
# Of these colours the graph names these classes.
COLOURS = {"car": (255, 0, 0), "road": (0, 255, 0), "sky": (0, 0, 255)}


def write_network(
    path: Path,
    outputs: int = CLASSES + 1,
    kind: str = "scores",
    size: tuple[Any, Any] = ("h", "w"),
    stride: int = 1,
) -> None:
    """A class wins where its channel is highest; the last output, which is background, wins by far everywhere."""
    kernel = np.zeros((outputs, 3, stride, stride), np.float32)
    for channel, name in enumerate(COLOURS):
        kernel[NAMES.index(name) % outputs, channel] = 20 / stride**2
    bias = np.zeros(outputs, np.float32)
    bias[CLASSES:] = 90
    nodes = [helper.make_node("Conv", ["pixels", "kernel", "bias"], ["scores"], strides=[stride, stride])]
    target = helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, outputs, "rows", "columns"])
    if kind == "softmax":
        nodes.append(helper.make_node("Softmax", ["scores"], ["out"], axis=1))
    elif kind in ("numbers", "numbers with axis"):
        keep = int(kind.endswith("axis"))
        nodes.append(helper.make_node("ArgMax", ["scores"], ["out"], axis=1, keepdims=keep))
        axes = [1, *[1] * keep, "rows", "columns"]
        target = helper.make_tensor_value_info("out", TensorProto.INT64, axes)
    else:
        nodes.append(helper.make_node("Identity", ["scores"], ["out"]))
    source = helper.make_tensor_value_info("pixels", TensorProto.FLOAT, [1, 3, *size])
    graph(path, nodes, source, target, {"kernel": kernel, "bias": bias})


def write(folder: Path, card: dict[str, Any] | None = None, **network: Any) -> str:
    """A whole model; returns its value."""
    write_network(folder / "street.onnx", **network)
    (folder / "street.json").write_text(json.dumps(CARD | (card or {})))
    return str(folder / "street.onnx")


def picture(height: int = 16, width: int = 32) -> np.ndarray:
    """Sky above; below it a car at the left and road at the right."""
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[: height // 2] = COLOURS["sky"]
    rgb[height // 2 :, : width // 2] = COLOURS["car"]
    rgb[height // 2 :, width // 2 :] = COLOURS["road"]
    return rgb


def class_vector(name: str) -> np.ndarray:
    mean = Mini().embed_text(WORDS_OF[name]).mean(axis=0)
    return mean / np.linalg.norm(mean)


@pytest.mark.parametrize(
    "network",
    [
        {},
        {"outputs": CLASSES},
        {"outputs": CLASSES, "kind": "softmax"},
        {"outputs": CLASSES, "kind": "numbers"},
        {"outputs": CLASSES, "kind": "numbers with axis"},
        {"size": (16, 32)},
        {"stride": 2},
        {"stride": 8},
    ],
    ids=str,
)
def test_a_pixel_has_the_words_of_its_class(tmp_path: Path, network: dict[str, Any]) -> None:
    vlm = Cityscapes(write(tmp_path, **network))
    features = vlm.embed_image(picture())
    side = network.get("stride", 1)
    assert (
        features.shape == (16 // max(4, side), 32 // max(4, side), vlm.dim) and features.dtype == np.float32
    )
    high, wide = features.shape[:2]
    expected = np.tile(class_vector("sky"), (high, wide, 1))
    expected[high // 2 :, : wide // 2] = class_vector("car")
    expected[high // 2 :, wide // 2 :] = class_vector("road")
    np.testing.assert_allclose(features, expected, atol=1e-5)


def test_words_are_those_of_mini_and_find_their_class(tmp_path: Path) -> None:
    vlm = Cityscapes(write(tmp_path))
    words = ["sedan", "asphalt", "clouds"]
    vectors = vlm.embed_text(words)
    np.testing.assert_array_equal(vectors, Mini().embed_text(words))
    nearest = (vlm.embed_image(picture()) @ vectors.T).argmax(-1)
    np.testing.assert_array_equal(nearest[0], 2)
    np.testing.assert_array_equal(nearest[-1], [0, 0, 0, 0, 1, 1, 1, 1])
    assert vlm.unknown_words(["a sedqn"]) == Mini().unknown_words(["a sedqn"]) != []


def test_probabilities_are_the_softmax_without_background(tmp_path: Path) -> None:
    vlm = Cityscapes(write(tmp_path))
    probabilities = vlm.class_probabilities(np.full((16, 32, 3), (153, 128, 77), np.uint8))
    scores = np.zeros(CLASSES)
    for name, value in zip(COLOURS, (153, 128, 77), strict=True):
        scores[NAMES.index(name)] = 20 * (value / 255 - 0.5) / 0.5
    expected = np.exp(scores) / np.exp(scores).sum()
    np.testing.assert_allclose(probabilities, np.broadcast_to(expected, (4, 8, CLASSES)), atol=1e-5)
    np.testing.assert_allclose(probabilities.sum(-1), 1, atol=1e-5)


def test_a_cell_of_two_classes_is_between_them(tmp_path: Path) -> None:
    """The border of sky is in the middle of the second row of cells."""
    rgb = picture()
    rgb[6:, :] = COLOURS["road"]
    rgb[:6, :] = COLOURS["sky"]
    vlm = Cityscapes(write(tmp_path))
    np.testing.assert_allclose(
        vlm.class_probabilities(rgb)[1, :, [NAMES.index("sky"), NAMES.index("road")]], 0.5, atol=1e-5
    )
    between = class_vector("sky") + class_vector("road")
    np.testing.assert_allclose(vlm.embed_image(rgb)[1, 3], between / np.linalg.norm(between), atol=1e-5)


def test_channels_may_be_reversed(tmp_path: Path) -> None:
    vlm = Cityscapes(write(tmp_path, {"channels": "bgr"}))
    np.testing.assert_allclose(
        vlm.embed_image(picture()), Cityscapes(write(tmp_path)).embed_image(picture()[..., ::-1]), atol=1e-6
    )


@pytest.mark.parametrize("number", [19, 255, -1])
def test_a_number_that_is_no_class_is_any_class(tmp_path: Path, number: int) -> None:
    path = tmp_path / "street.onnx"
    (tmp_path / "street.json").write_text(json.dumps(CARD))
    graph(
        path,
        [
            helper.make_node("ReduceMean", ["pixels"], ["mean"], axes=[1], keepdims=0),
            helper.make_node("Mul", ["mean", "zero"], ["zeros"]),
            helper.make_node("Add", ["zeros", "number"], ["out"]),
        ],
        helper.make_tensor_value_info("pixels", TensorProto.FLOAT, [1, 3, "h", "w"]),
        helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, "h", "w"]),
        {"zero": np.array([0], np.float32), "number": np.array([number], np.float32)},
    )
    vlm = Cityscapes(str(path))
    np.testing.assert_allclose(vlm.class_probabilities(picture()), 1 / CLASSES, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(vlm.embed_image(picture()), axis=-1), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("size", "frame", "expected"),
    [
        ((16, 32), None, (16, 32)),
        ((32, 64), None, (16, 32)),  # shrunk
        ((8, 8), None, (32, 32)),  # enlarged
        ((9, 40), None, (8, 32)),  # to the nearest whole multiples
        ((1, 900), None, (8, 32)),
        ((16, 32), (16, 32), (16, 32)),
        ((30, 30), (16, 32), (16, 16)),  # as high as the frame, the rest is padding
        ((10, 64), (16, 32), (4, 32)),
        ((100, 1), (17, 33), (16, 4)),
    ],
)
def test_a_picture_becomes_whole_cells(size: Any, frame: Any, expected: tuple[int, int]) -> None:
    assert resized_size(size, frame, 8, 32) == expected


@pytest.mark.parametrize("stride", [1, 2])
def test_the_padding_of_a_fixed_size_is_no_part_of_the_features(tmp_path: Path, stride: int) -> None:
    vlm = Cityscapes(write(tmp_path, size=(40, 40), stride=stride))
    features = vlm.embed_image(picture(16, 32))  # resized to 20 x 40
    assert features.shape == (5, 10, vlm.dim)
    np.testing.assert_allclose(
        features[-1], [class_vector("car")] * 5 + [class_vector("road")] * 5, atol=1e-4
    )


def test_the_background_rule_suits_the_classes(tmp_path: Path) -> None:
    vlm = Cityscapes(write(tmp_path))
    background = vlm.embed_text(["vegetation", "road", "sky", "building", "wall", "fence", "sidewalk"])
    against = vlm.embed_text(vlm.background.against)
    assert vlm.background.against == OBJECTS
    of_class = {
        name: background_score(class_vector(name)[None] @ background.T, class_vector(name)[None] @ against.T)[
            0
        ]
        for name in NAMES
    }
    objects = ("person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle")
    stuff = ("road", "sidewalk", "building", "wall", "fence", "vegetation", "terrain", "sky")
    assert max(of_class[name] for name in objects) < vlm.background.threshold - 0.05
    assert min(of_class[name] for name in stuff) > vlm.background.threshold + 0.05


def test_files_are_the_graph_its_card_and_the_words(tmp_path: Path) -> None:
    weights = write(tmp_path)
    (tmp_path / "street.onnx.data").write_bytes(b"weights beside the graph")
    (tmp_path / "other.onnx.data").write_bytes(b"not of this model")
    family, after = model_family(f"cityscapes:{weights}")
    assert family.files(after) == files(weights)
    assert [path.name for path in files(weights)] == [
        "street.json",
        "street.onnx",
        "street.onnx.data",
        "mini_text.safetensors",
        "mini_phrases.txt",
        "mini_tokenizer.json",
    ]
    assert family.open(after).name == f"cityscapes:{weights}"


def rewritten(**changes: Any) -> Callable[[Path], Any]:
    return lambda path: path.with_suffix(".json").write_text(json.dumps(CARD | changes))


def channels_last(path: Path) -> None:
    graph(
        path,
        [helper.make_node("Identity", ["pixels"], ["out"])],
        helper.make_tensor_value_info("pixels", TensorProto.FLOAT, [1, "h", "w", 3]),
        helper.make_tensor_value_info("out", TensorProto.FLOAT, [1, "h", "w", 3]),
        {},
    )


BAD: list[tuple[Callable[[Path], Any], str]] = [
    (lambda path: path.unlink(), "expected a file NAME.onnx"),
    (
        lambda path: path.with_suffix(".json").unlink(),
        "no street.json beside it; .*mean, std, multiple, channels",
    ),
    (rewritten(channels="gbr"), "'channels' is 'gbr', expected \"rgb\" or \"bgr\""),
    (rewritten(longer_side_px=0), "'longer_side_px' is 0, expected a whole number"),
    (rewritten(scale=2), "unknown key 'scale'"),
    (rewritten(std=[1, 1, 0]), "expected 3 positive numbers"),
    (lambda path: path.write_bytes(b"no graph"), "onnxruntime cannot read it"),
    (channels_last, r"takes an input of shape \(1, 'h', 'w', 3\), expected \(1, 3, h, w\)"),
    (
        lambda path: write_network(path, outputs=21),
        r"gives shape \(1, 21, 16, 32\), expected \(1, 19, h', w'\)",
    ),
    (lambda path: write_network(path, size=("h", 7)), "cannot take an input of shape"),
]


@pytest.mark.parametrize(("spoil", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_a_bad_model_is_one_clear_line(tmp_path: Path, spoil: Callable[[Path], Any], message: str) -> None:
    weights = write(tmp_path)
    spoil(Path(weights))
    with pytest.raises(BadInput, match=message) as failure:
        Cityscapes(weights).embed_image(picture())
    assert "\n" not in str(failure.value) and "street" in str(failure.value)


def test_no_file_named_is_one_clear_line() -> None:
    with pytest.raises(BadInput, match='model = "cityscapes:": expected a file NAME.onnx'):
        files("")


def test_onnxruntime_that_is_not_installed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vlm = Cityscapes(write(tmp_path))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert len(vlm.embed_text(["car"])) == 1  # words need no network
    with pytest.raises(BadSetting, match=r"pip install 'upvl\[onnx\]'"):
        vlm.embed_image(picture())
