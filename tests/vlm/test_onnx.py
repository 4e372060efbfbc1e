"""The ONNX adapter: graphs of two operators, against numpy."""

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
from PIL import Image
from tiny_graph import graph
from tokenizers import Tokenizer, models, pre_tokenizers, processors

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.types import BackgroundRule
from upvl_cli.vlm.onnx import Onnx, files

DIM, CONTEXT, PATCH = 5, 4, 8
WORDS = {"<start>": 0, "<end>": 1, "<unknown>": 2, "red": 3, "car": 4, "tree": 5, "<pad>": 6}
CARD = {
    "mean": [0.4, 0.5, 0.6],
    "std": [0.2, 0.25, 0.5],
    "multiple": PATCH,
    "context": CONTEXT,
    "pad_id": 6,
    "against": ["thing"],
    "threshold": 0.05,
}
RANDOM = np.random.default_rng(8)
KERNEL = RANDOM.normal(size=(DIM, 3, PATCH, PATCH)).astype(np.float32)
TABLE = RANDOM.normal(size=(len(WORDS), DIM)).astype(np.float32)


def write_image(folder: Path, kernel: np.ndarray = KERNEL) -> None:
    """A feature is a linear function of its patch."""
    graph(
        folder / "image.onnx",
        [helper.make_node("Conv", ["pixels", "kernel"], ["features"], strides=[PATCH, PATCH])],
        helper.make_tensor_value_info("pixels", TensorProto.FLOAT, [1, 3, "h", "w"]),
        helper.make_tensor_value_info("features", TensorProto.FLOAT, [1, len(kernel), "cells", "across"]),
        {"kernel": kernel},
    )


def write_text(folder: Path, kind: int = TensorProto.INT64) -> None:
    """A vector is the sum of its tokens'."""
    graph(
        folder / "text.onnx",
        [
            helper.make_node("Gather", ["table", "tokens"], ["each"]),
            helper.make_node("ReduceSum", ["each", "axis"], ["vectors"], keepdims=0),
        ],
        helper.make_tensor_value_info("tokens", kind, ["n", CONTEXT]),
        helper.make_tensor_value_info("vectors", TensorProto.FLOAT, ["n", "d"]),
        {"table": TABLE, "axis": np.array([1])},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A whole model."""
    write_image(tmp_path)
    write_text(tmp_path)
    tokenizer = Tokenizer(models.WordLevel(WORDS, unk_token="<unknown>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<start> $A <end>", pair=None, special_tokens=[("<start>", 0), ("<end>", 1)]
    )
    tokenizer.save(str(tmp_path / "tokenizer.json"))
    (tmp_path / "model.json").write_text(json.dumps(CARD))
    return tmp_path


def rewritten(**changes: Any) -> Callable[[Path], Any]:
    return lambda folder: (folder / "model.json").write_text(json.dumps(CARD | changes))


@pytest.mark.parametrize(
    ("words", "tokens"),
    [
        ("car", [0, 4, 1, 6]),  # filled up
        ("red car", [0, 3, 4, 1]),
        ("red tree car", [0, 3, 5, 1]),  # cut, its end kept
        ("lorry", [0, 2, 1, 6]),
    ],
)
def test_words_go_through_tokenizer_and_graph(folder: Path, words: str, tokens: list[int]) -> None:
    expected = TABLE[tokens].sum(axis=0)
    vectors = Onnx(str(folder)).embed_text(["car", words])
    assert vectors.shape == (2, DIM) and vectors.dtype == np.float32
    np.testing.assert_allclose(vectors[1], expected / np.linalg.norm(expected), atol=1e-6)


def test_no_words_are_no_vectors(folder: Path) -> None:
    assert Onnx(str(folder)).embed_text([]).shape == (0, DIM)


def test_pictures_go_through_the_graph(folder: Path) -> None:
    rgb = RANDOM.integers(0, 256, (2 * PATCH, 3 * PATCH, 3), dtype=np.uint8)
    pixels = (rgb / 255 - CARD["mean"]) / CARD["std"]
    patches = pixels.reshape(2, PATCH, 3, PATCH, 3)
    expected = np.einsum("iujvc,dcuv->ijd", patches, KERNEL)
    features = Onnx(str(folder)).embed_image(rgb)
    assert features.dtype == np.float32
    np.testing.assert_allclose(features, expected, atol=1e-4)


@pytest.mark.parametrize(("size", "scaled"), [((19, 37), (16, 40)), ((3, 60), (8, 64))])
def test_pictures_are_scaled_to_whole_cells(
    folder: Path, size: tuple[int, int], scaled: tuple[int, int]
) -> None:
    rgb = RANDOM.integers(0, 256, (*size, 3), dtype=np.uint8)
    whole = np.asarray(Image.fromarray(rgb).resize(scaled[::-1], Image.Resampling.BICUBIC))
    vlm = Onnx(str(folder))
    features = vlm.embed_image(rgb)
    assert features.shape == (scaled[0] // PATCH, scaled[1] // PATCH, DIM)
    np.testing.assert_array_equal(features, vlm.embed_image(whole))


def test_the_card_holds_the_rule_and_the_graph_the_length(folder: Path) -> None:
    vlm = Onnx(str(folder))
    assert vlm.background == BackgroundRule(("thing",), 0.05)
    assert vlm.dim == DIM


def test_files_are_what_makes_the_model(folder: Path) -> None:
    (folder / "image.onnx.data").write_bytes(b"weights beside the graph")
    (folder / "README.md").write_text("not the model")
    assert [path.name for path in files(str(folder))] == [
        "image.onnx",
        "image.onnx.data",
        "model.json",
        "text.onnx",
        "tokenizer.json",
    ]


BAD: list[tuple[Callable[[Path], Any], str]] = [
    (lambda folder: (folder / "text.onnx").unlink(), "it lacks text.onnx"),
    (rewritten(thresold=0.1), "unknown key 'thresold' .*known keys: mean, std"),
    (
        lambda folder: (folder / "model.json").write_text('{"mean": [1, 1, 1]}'),
        "'std' is missing; 'multiple' is",
    ),
    (lambda folder: (folder / "model.json").write_text("mean: 3"), "cannot be read as JSON"),
    (rewritten(mean=[1, 2]), r"'mean' is \[1, 2\], expected 3 numbers"),
    (rewritten(mean=[1, 2, "3"]), "expected 3 numbers"),
    (rewritten(std=[1, 0, 1]), "expected 3 positive numbers"),
    (rewritten(std=[1, float("nan"), 1]), "expected 3 positive numbers"),
    (rewritten(multiple=0), "'multiple' is 0, expected a whole number from 1"),
    (rewritten(context=True), "'context' is True, expected"),
    (rewritten(pad_id=-1), "'pad_id' is -1, expected"),
    (rewritten(against="thing"), "'against' is 'thing', expected a list of words"),
    (rewritten(threshold="high"), "'threshold' is 'high', expected a number"),
    (rewritten(context=9), "text.onnx: cannot take an input of shape"),
    (
        lambda folder: (folder / "image.onnx").write_bytes(b"no graph"),
        "image.onnx: onnxruntime cannot read it",
    ),
    (lambda folder: (folder / "tokenizer.json").write_text("{}"), "cannot be read as a tokenizer"),
    (lambda folder: write_text(folder, TensorProto.INT32), r"has inputs \['tensor\(int32\)'\]"),
    (lambda folder: write_image(folder, KERNEL[:3]), r"gives \(1, 3, 1, 1\), expected \(1, 5, h', w'\)"),
]


@pytest.mark.parametrize(("spoil", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_a_bad_folder_is_one_clear_line(folder: Path, spoil: Callable[[Path], Any], message: str) -> None:
    spoil(folder)
    with pytest.raises(BadInput, match=message) as failure:
        vlm = Onnx(str(folder))
        vlm.embed_text(["car"])
        vlm.embed_image(np.zeros((PATCH, PATCH, 3), np.uint8))
    assert "\n" not in str(failure.value) and str(folder) in str(failure.value)


@pytest.mark.parametrize("weights", ["", "/no/such/folder"])
def test_no_folder_is_one_clear_line(weights: str) -> None:
    with pytest.raises(BadInput, match="expected a folder with image.onnx"):
        files(weights)


def test_onnxruntime_that_is_not_installed_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # Python's own mark of what cannot be imported
    with pytest.raises(BadSetting, match=r"pip install 'upvl\[onnx\]'"):
        Onnx(str(folder)).embed_text(["car"])
