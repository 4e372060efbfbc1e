"""CLIP and SigLIP against the library's own forward pass, on tiny true checkpoints."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("transformers", reason="needs the extra clip")

import tiny_clip
import torch
from tiny_clip import CONTEXT, IMAGE, MEAN, PATCH, STD
from torch.nn import functional

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.vlm import siglip
from upvl_cli.vlm.clip import Clip, files, resized_size, window_starts
from upvl_cli.vlm.siglip import Siglip

WORDS = ["car", "red car", "tree"]
Saved = tuple[Path, Any]


@pytest.fixture(scope="module", params=[tiny_clip.clip, tiny_clip.siglip], ids=["clip", "siglip"])
def saved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Saved:
    """A checkpoint and the library's own model of it."""
    folder = tmp_path_factory.mktemp(request.param.__name__)
    return folder, request.param(folder)


def opened(saved: Saved) -> Clip:
    """Our model of the checkpoint."""
    folder, model = saved
    return Siglip(str(folder)) if model.config.model_type == "siglip" else Clip(str(folder))


def picture(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (height, width, 3), dtype=np.uint8)


def normalised(rgb: np.ndarray) -> torch.Tensor:
    """(1, 3, h, w) what the library's networks take."""
    return torch.tensor((rgb / 255 - MEAN) / STD).permute(2, 0, 1)[None].float()


def library_values(model: Any, pixels: torch.Tensor) -> np.ndarray:
    """(4, 4, d) features of one window, from what passes through the library's modules in its own forward."""
    vision = model.vision_model
    caught: dict[str, torch.Tensor] = {}
    attention = vision.encoder.layers[-1].self_attn
    hooks = [attention.v_proj.register_forward_hook(lambda _m, _i, output: caught.update(values=output))]
    with torch.inference_mode():
        model.get_image_features(pixels)
        tokens = vision.post_layernorm(attention.out_proj(caught["values"]))
        if hasattr(model, "visual_projection"):
            features = model.visual_projection(tokens[:, 1:])
        else:
            # The pooling head, shown one patch at a time, can attend to that one only.
            features = vision.head(tokens[0][:, None])[None]
    for hook in hooks:
        hook.remove()
    return features.reshape(4, 4, -1).numpy()


def test_words_are_the_librarys_text_features(saved: Saved) -> None:
    folder, model = saved
    from transformers import AutoTokenizer

    full = (
        {"padding": "max_length", "max_length": CONTEXT}
        if model.config.model_type == "siglip"
        else {"padding": True}
    )
    tokens = AutoTokenizer.from_pretrained(folder)(
        [f"a photo of a {word}." for word in WORDS], return_tensors="pt", **full
    )
    with torch.inference_mode():
        expected = functional.normalize(model.get_text_features(tokens["input_ids"]).pooler_output, dim=-1)
    vlm = opened(saved)
    vectors = vlm.embed_text(WORDS)
    assert vectors.dtype == np.float32 and vectors.shape == (3, vlm.dim)
    np.testing.assert_allclose(vectors, expected.numpy(), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)


def test_a_word_has_one_vector_in_any_company(saved: Saved) -> None:
    vlm = opened(saved)
    many = vlm.embed_text(["Car", "tree of a red photo of a car", *["red"] * 100])
    np.testing.assert_allclose(many[0], vlm.embed_text(["car"])[0], atol=1e-6)
    assert vlm.embed_text([]).shape == (0, vlm.dim)
    assert vlm.embed_text(["car " * 50]).shape == (1, vlm.dim)  # longer than the context


def test_words_need_no_vision_tower(saved: Saved) -> None:
    vlm = opened(saved)
    vlm.embed_text(["car"])
    assert "_image" not in vars(vlm)


def test_one_window_is_the_value_path_of_the_library(saved: Saved) -> None:
    _, model = saved
    rgb = picture(IMAGE, IMAGE)
    pixels = normalised(rgb)
    if (
        model.config.model_type == "siglip"
    ):  # 35 pixels make 4 patches of 8; the library leaves the rest unread
        pixels = functional.pad(pixels, (0, 3, 0, 3))
    features = opened(saved).embed_image(rgb)
    assert features.dtype == np.float32
    np.testing.assert_allclose(features, library_values(model, pixels), atol=1e-5)


def test_the_whole_last_block_would_give_the_librarys_image(tmp_path: Path) -> None:
    model = tiny_clip.clip(tmp_path)
    pixels = normalised(picture(IMAGE, IMAGE))
    tower = Clip(str(tmp_path))._image
    with torch.inference_mode():
        whole = tower._last(tower.before_last(pixels), None)
        pooled = tower._projection(tower._vision.post_layernorm(whole[:, 0]))
        expected = model.get_image_features(pixels).pooler_output
    np.testing.assert_allclose(pooled.numpy(), expected.numpy(), atol=1e-5)


def test_overlapping_windows_are_averaged(saved: Saved) -> None:
    """Two windows, at cells 0 and 2 of six, beside each other."""
    _, model = saved
    rgb = picture(IMAGE, 6 * PATCH)
    pixels = normalised(rgb)
    if model.config.model_type == "siglip":
        pixels = functional.pad(pixels, (0, 3, 0, 3))
    side = model.config.vision_config.image_size
    left = library_values(model, pixels[..., :side])
    right = library_values(model, pixels[..., 2 * PATCH : 2 * PATCH + side])
    expected = np.concatenate([left[:, :2], (left[:, 2:] + right[:, :2]) / 2, right[:, 2:]], axis=1)
    np.testing.assert_allclose(opened(saved).embed_image(rgb), expected, atol=1e-5)


def test_one_colour_without_places_has_one_feature(tmp_path: Path) -> None:
    """Patches of one colour differ by their place in the window only."""
    model = tiny_clip.clip(tmp_path)
    with torch.no_grad():
        model.vision_model.embeddings.position_embedding.weight.zero_()
    model.save_pretrained(tmp_path)
    features = Clip(str(tmp_path)).embed_image(np.full((70, 101, 3), 90, np.uint8))
    assert features.shape == (9, 13, 10)
    np.testing.assert_allclose(features, np.broadcast_to(features[4, 6], features.shape), atol=1e-5)


@pytest.mark.parametrize(
    ("height", "width", "expected"),
    [
        (32, 32, (32, 32)),  # one window
        (40, 80, (40, 80)),  # larger than a window: as it is
        (43, 81, (40, 80)),  # to the nearest whole patches
        (16, 64, (32, 128)),  # the shorter side becomes a window
        (33, 32, (32, 32)),
        (1, 3, (32, 96)),
    ],
)
def test_a_picture_becomes_whole_patches(height: int, width: int, expected: tuple[int, int]) -> None:
    assert resized_size(height, width, 4, 8) == expected


@pytest.mark.parametrize("cells", [1, 2, 4, 7, 14, 24])
def test_windows_cover_and_overlap(cells: int) -> None:
    for length in range(cells, 5 * cells):
        starts = window_starts(length, cells)
        assert starts[0] == 0 and starts[-1] == length - cells
        steps = np.diff(starts)
        assert (steps > 0).all() and (steps <= max(1, cells * 0.75)).all()


def test_cells_cover_the_picture(saved: Saved) -> None:
    assert opened(saved).embed_image(picture(50, 90)).shape[:2] == (6, 11)
    assert opened(saved).embed_image(picture(10, 21)).shape[:2] == (4, 8)


def test_files_are_what_makes_the_model(saved: Saved) -> None:
    of_kind = siglip.files if saved[1].config.model_type == "siglip" else files
    names = [path.name for path in of_kind(str(saved[0]))]
    assert names == [
        "config.json",
        "model.safetensors",
        "preprocessor_config.json",
        "tokenizer.json",
        "tokenizer_config.json",
    ]


def test_a_model_of_the_hub_that_was_fetched_before_needs_no_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(BadInput, match="could not be fetched from the Hugging Face hub") as failure:
        files("someone/tiny-clip")
    assert "\n" not in str(failure.value)
    snapshot = tmp_path / "models--someone--tiny-clip" / "snapshots" / ("0" * 40)
    snapshot.mkdir(parents=True)
    tiny_clip.clip(snapshot)
    (tmp_path / "models--someone--tiny-clip" / "refs").mkdir()
    (tmp_path / "models--someone--tiny-clip" / "refs" / "main").write_text("0" * 40)
    assert files("someone/tiny-clip")[0] == snapshot / "config.json"
    assert Clip("someone/tiny-clip").embed_text(["car"]).shape == (1, 10)


def pickled(folder: Path) -> None:
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")


def other_kind(folder: Path) -> None:
    (folder / "config.json").write_text(json.dumps({"model_type": "blip"}))


def of_siglip(folder: Path) -> None:
    (folder / "config.json").write_text(json.dumps({"model_type": "siglip"}))


def cut(folder: Path) -> None:
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:300])


def of_half_the_weights(folder: Path) -> None:
    from safetensors.torch import load_file, save_file

    path = folder / "model.safetensors"
    save_file({name: value for name, value in load_file(path).items() if "layers.1" not in name}, path)


def without_deviation(folder: Path) -> None:
    (folder / "preprocessor_config.json").write_text(json.dumps({"image_mean": MEAN, "image_std": [0, 1, 1]}))


BAD: list[tuple[Callable[[Path], Any], str]] = [
    (shutil.rmtree, "there is no folder"),
    (lambda folder: (folder / "config.json").unlink(), "lacks config.json; expected a checkpoint"),
    (pickled, "pickles, which are never loaded"),
    (lambda folder: (folder / "tokenizer.json").unlink(), "lacks tokenizer.json or vocab.json"),
    (lambda folder: (folder / "preprocessor_config.json").unlink(), "lacks preprocessor_config.json"),
    (lambda folder: (folder / "config.json").write_text("{"), "cannot be read as JSON"),
    (lambda folder: (folder / "config.json").write_text("[]"), "holds a list, expected an object"),
    (other_kind, "model_type is 'blip', expected clip$"),
    (of_siglip, "expected clip; for SigLIP write model = .siglip:FOLDER.$"),
    (cut, "transformers cannot read it"),
    (of_half_the_weights, "lacks weights: "),
    (lambda folder: (folder / "tokenizer.json").write_text("{}"), "transformers cannot read it"),
    (without_deviation, "3 numbers each, image_std positive"),
    (lambda folder: (folder / "preprocessor_config.json").write_text("{}"), "is missing or no number"),
]


@pytest.mark.parametrize(("spoil", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_a_bad_folder_is_one_clear_line(tmp_path: Path, spoil: Callable[[Path], Any], message: str) -> None:
    folder = tmp_path / "clip"
    tiny_clip.clip(folder)
    spoil(folder)
    with pytest.raises(BadInput, match=message) as failure:
        vlm = Clip(str(folder))
        vlm.embed_text(["car"])
        vlm.embed_image(picture(32, 32))
    assert "\n" not in str(failure.value) and "clip" in str(failure.value)


def test_no_weights_named_is_one_clear_line() -> None:
    with pytest.raises(BadInput, match='model = "clip:": there is no folder'):
        files("")


@pytest.mark.parametrize("library", ["transformers", "huggingface_hub"])
def test_a_library_that_is_not_installed_is_named(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny_clip.clip(tmp_path)
    monkeypatch.setitem(sys.modules, library, None)  # Python's own mark of a module that cannot be imported
    with pytest.raises(BadSetting, match=r"pip install 'upvl\[clip\]'"):
        Clip(str(tmp_path) if library == "transformers" else "someone/tiny-clip")
