"""OpenSeg: a tiny SavedModel with the signature of the exported one."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("transformers", reason="needs the extra openseg")

import tiny_clip

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.vlm.clip import Clip
from upvl_cli.vlm.openseg import OpenSeg, files

SQUARE = 20  # in the place of 640
DIM = 10


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a user has, but for the program in saved_model.pb."""
    place = tmp_path / "openseg"
    tiny_clip.clip(place / "text")
    (place / "text" / "preprocessor_config.json").unlink()  # words need none
    (place / "variables").mkdir()
    (place / "variables" / "variables.index").write_bytes(b"")
    (place / "variables" / "variables.data-00000-of-00001").write_bytes(b"")
    (place / "saved_model.pb").write_bytes(b"no program")
    return place


def tensorflow() -> Any:
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    return pytest.importorskip("tensorflow", reason="needs the extra openseg")


def export(place: Path, dim: int = DIM, regions: str = "ppixel_ave_feat") -> None:
    """Write a SavedModel: a pixel's feature is its colour, then ones; the left half is region of twice that.

    Like OpenSeg it decodes the picture, scales its longer side to a square's and pads the rest.
    """
    tf = tensorflow()

    class Network(tf.Module):
        def __init__(self) -> None:
            super().__init__()
            self.one = tf.Variable(1.0)

        @tf.function(
            input_signature=[
                tf.TensorSpec([], tf.string, name="inp_image_bytes"),
                tf.TensorSpec([1, None, dim], tf.float32, name="inp_text_emb"),
            ]
        )
        def serve(self, inp_image_bytes: Any, inp_text_emb: Any) -> dict[str, Any]:
            rgb = tf.cast(
                tf.io.decode_image(inp_image_bytes, channels=3, expand_animations=False), tf.float32
            )
            size = tf.cast(tf.shape(rgb)[:2], tf.float32)
            scaled = tf.round(size * SQUARE / tf.reduce_max(size))
            high, wide = tf.unstack(tf.cast(scaled, tf.int32))
            small = tf.image.resize(rgb, [high, wide], method="nearest")
            small = tf.image.pad_to_bounding_box(small, 0, 0, SQUARE, SQUARE)
            pixels = tf.concat([small, tf.ones([SQUARE, SQUARE, dim - 3]) * self.one], axis=-1)[None]
            left = tf.cast(tf.range(SQUARE) < wide // 2, tf.float32)[None, None, :, None]
            info = tf.stack([size, tf.constant([SQUARE, SQUARE], tf.float32), scaled / size, tf.zeros([2])])
            return {regions: 2 * pixels * left, "image_embedding_feat": pixels, "image_info": info}

    network = Network()
    tf.saved_model.save(network, str(place), signatures={"serving_default": network.serve})


def test_features_are_those_of_the_part_that_the_picture_fills(folder: Path) -> None:
    export(folder)
    rgb = np.random.default_rng(1).integers(0, 256, (10, 2 * SQUARE, 3), dtype=np.uint8)
    vlm = OpenSeg(str(folder))
    features = vlm.embed_image(rgb)
    assert features.shape == (5, SQUARE, DIM) and features.dtype == np.float32
    small = rgb[1::2, 1::2].astype(np.float32)  # the nearest of two by two
    expected = np.concatenate([small, np.ones((5, SQUARE, DIM - 3), np.float32)], axis=2)
    expected[:, : SQUARE // 2] *= 2  # in the region its mean, outside the pixel's own
    np.testing.assert_allclose(features, expected)


def test_text_of_another_length_is_one_clear_line(folder: Path) -> None:
    export(folder, dim=12)
    with pytest.raises(BadInput, match="takes words of 12 numbers and text/ gives 10"):
        OpenSeg(str(folder)).embed_image(np.zeros((4, 4, 3), np.uint8))


def test_another_program_is_one_clear_line(folder: Path) -> None:
    export(folder, regions="something")
    with pytest.raises(BadInput, match="serving_default lacks ppixel_ave_feat; expected OpenSeg's"):
        OpenSeg(str(folder)).embed_image(np.zeros((4, 4, 3), np.uint8))


def test_a_broken_program_is_one_clear_line(folder: Path) -> None:
    tensorflow()
    with pytest.raises(BadInput, match="cannot be read as a SavedModel") as failure:
        OpenSeg(str(folder)).embed_image(np.zeros((4, 4, 3), np.uint8))
    assert "\n" not in str(failure.value)


def test_words_are_those_of_the_text_tower(folder: Path, tmp_path: Path) -> None:
    tiny_clip.clip(tmp_path / "clip")
    vlm = OpenSeg(str(folder))
    assert vlm.dim == DIM
    np.testing.assert_array_equal(vlm.embed_text(["car"]), Clip(str(tmp_path / "clip")).embed_text(["car"]))


def test_a_text_tower_alone_does(folder: Path) -> None:
    from transformers import CLIPTextModelWithProjection

    whole = OpenSeg(str(folder)).embed_text(["car"])
    model = tiny_clip.clip(folder / "text")
    config = model.config.text_config
    config.projection_dim = DIM
    CLIPTextModelWithProjection.from_pretrained(folder / "text", config=config).save_pretrained(
        folder / "text"
    )
    assert '"clip_text_model"' in (folder / "text" / "config.json").read_text()
    np.testing.assert_allclose(OpenSeg(str(folder)).embed_text(["car"]), whole, atol=1e-6)


def test_files_are_what_makes_the_model(folder: Path) -> None:
    assert [str(path.relative_to(folder)) for path in files(str(folder))] == [
        "saved_model.pb",
        "text/config.json",
        "text/model.safetensors",
        "text/tokenizer.json",
        "text/tokenizer_config.json",
        "variables/variables.data-00000-of-00001",
        "variables/variables.index",
    ]


def without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).rename(folder.parent / "elsewhere")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without("saved_model.pb"), "it lacks saved_model.pb"),
        (without("variables"), "it lacks variables/"),
        (without("text"), "it lacks text/"),
        (without("text/model.safetensors"), "lacks .*safetensors"),
    ],
)
def test_a_bad_folder_is_one_clear_line(folder: Path, spoil: Callable[[Path], None], message: str) -> None:
    spoil(folder)
    with pytest.raises(BadInput, match=message) as failure:
        OpenSeg(str(folder))
    assert "\n" not in str(failure.value) and "openseg" in str(failure.value)


@pytest.mark.parametrize("weights", ["", "/no/such/folder"])
def test_no_folder_is_one_clear_line(weights: str) -> None:
    with pytest.raises(BadInput, match="expected a folder that holds the exported OpenSeg"):
        files(weights)


def test_tensorflow_that_is_not_installed_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorflow", None)  # Python's own mark of what cannot be imported
    with pytest.raises(BadSetting, match=r"pip install 'upvl\[openseg\]'"):
        OpenSeg(str(folder)).embed_image(np.zeros((4, 4, 3), np.uint8))
