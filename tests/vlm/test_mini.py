"""The model that ships: words, pictures, and that both meet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from upvl_cli.errors import BadSetting
from upvl_cli.vlm import MODELS, model_family
from upvl_cli.vlm.mini import (
    BUDGET_PX,
    COARSE_SCALE,
    COARSE_WEIGHT,
    CONCEPTS,
    FILES,
    MAX_SCALE,
    WEIGHTS,
    Mini,
)
from upvl_cli.vlm.mini_text import ATTRACTION, MiniText, normalize, unit


@pytest.fixture(scope="module")
def model() -> Mini:
    return Mini()


def nearest(model: Mini, word: str, words: list[str]) -> str:
    likeness = model.embed_text(words) @ model.embed_text([word])[0]
    return words[int(likeness.argmax())]


TRAFFIC = [
    "car", "truck", "bus", "van", "pedestrian", "bicycle", "motorcycle", "tree", "road", "building", "traffic sign",
    "pole", "fence", "sidewalk", "sky",
]  # fmt: skip


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("automobile", "car"), ("lorry", "truck"), ("street", "road"), ("person", "pedestrian"), ("cyclist", "bicycle"),
        ("pavement", "sidewalk"), ("school bus", "bus"), ("motorbike", "motorcycle"), ("bush", "tree"),
        ("house", "building"), ("road sign", "traffic sign"),
    ],
)  # fmt: skip
def test_synonyms_are_near(model: Mini, word: str, expected: str) -> None:
    assert nearest(model, word, TRAFFIC) == expected


def test_any_phrase_has_a_vector_of_length_one(model: Mini) -> None:
    words = ["car", "a zebra-striped hovercraft", "Straße", "xqzzt", "A Fire Truck.", "the  fire truck"]
    vectors = model.embed_text(words)
    assert vectors.shape == (6, model.dim)
    assert vectors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    np.testing.assert_array_equal(vectors[4], vectors[5])  # articles, case and spaces do not count


def test_nothing_has_no_vector_and_is_like_nothing(model: Mini) -> None:
    assert not model.embed_text(["", "  "]).any()
    assert model.embed_text([]).shape == (0, model.dim)


def test_a_phrase_outside_of_the_table_is_the_mean_of_its_tokens(model: Mini) -> None:
    text = model.text
    assert "purple spaceship" not in text.phrases
    np.testing.assert_array_equal(
        text.embed_plain(["purple spaceship"])[0], text.embed_tokens("purple spaceship")
    )
    # Not far from what the full model says where it has been asked.
    alike = [
        text.embed_tokens(phrase) @ vector for phrase, vector in zip(text.phrases, text.vectors, strict=True)
    ]
    assert np.mean(alike) > 0.8


@pytest.mark.parametrize(
    ("given", "expected"), [("The Car", "car"), ("a", "a"), (" an  old bus. ", "old bus")]
)
def test_phrases_are_made_plain(given: str, expected: str) -> None:
    assert normalize(given) == expected


@pytest.mark.parametrize(
    ("height", "width"), [(64, 96), (61, 90), (375, 1242), (900, 1600), (400, 20), (6, 5)]
)
def test_cells_cover_the_picture(model: Mini, height: int, width: int) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    cells = model.embed_image(picture)
    scale = min((BUDGET_PX / (height * width)) ** 0.5, MAX_SCALE)
    assert cells.shape == (round(height * scale / 4), round(width * scale / 4), model.dim)
    np.testing.assert_allclose(np.linalg.norm(cells, axis=2), 1, atol=1e-4)
    assert np.isfinite(cells).all()
    np.testing.assert_array_equal(cells, model.embed_image(picture))


def test_a_small_picture_is_looked_at_again_mirrored_and_reduced(model: Mini) -> None:
    import torch
    from torch.nn import functional

    picture = np.random.default_rng(0).integers(0, 255, (128, 160, 3), dtype=np.uint8)
    pixels = torch.tensor(picture).permute(2, 0, 1)[None].float()
    with torch.inference_mode():
        fine = model._embed_at(pixels, MAX_SCALE)
        coarse = model._embed_at(pixels.flip(-1), MAX_SCALE * COARSE_SCALE).flip(-1)
    coarse = functional.interpolate(coarse, fine.shape[-2:], mode="bilinear", align_corners=False)
    both = functional.normalize(fine + COARSE_WEIGHT * coarse, dim=1)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(model.embed_image(picture), both, atol=1e-5)


def test_a_large_picture_is_looked_at_once(model: Mini) -> None:
    import torch

    picture = np.random.default_rng(0).integers(0, 255, (375, 1242, 3), dtype=np.uint8)
    pixels = torch.tensor(picture).permute(2, 0, 1)[None].float()
    with torch.inference_mode():
        once = model._embed_at(pixels, (BUDGET_PX / (375 * 1242)) ** 0.5)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(model.embed_image(picture), once, atol=1e-5)


def test_words_go_where_pictures_put_their_concept() -> None:
    """Two concepts of one direction in text, and of others in pictures."""
    concepts = unit(np.array([[1.0, 0.2, 0.0, 0.0], [1.0, -0.2, 0.0, 0.0]], np.float32))
    directions = np.eye(4, dtype=np.float32)[[2, 3]]
    phrases = np.vstack([concepts, unit(np.array([[0.0, 0.0, 0.0, 1.0]], np.float32))])
    tables = {
        "tokens": np.zeros((30522, 4), np.int8), "token_scale": np.zeros(30522, np.float32),
        "phrases": np.rint(127 * phrases).astype(np.int8), "phrase_scale": np.full(3, 1 / 127, np.float32),
        "concepts": np.rint(127 * concepts).astype(np.int8), "concept_scale": np.full(2, 1 / 127, np.float32),
        "directions": np.rint(127 * directions).astype(np.int8), "direction_scale": np.full(2, 1 / 127, np.float32),
    }  # fmt: skip
    text = MiniText(tables, ["fire truck", "truck", "music"], WEIGHTS / FILES[3])
    fire, truck, music = text.embed(["fire truck", "truck", "music"])
    plain = text.embed_plain(["fire truck", "truck"])
    assert plain[0] @ plain[1] > 0.9
    assert fire @ truck < 0.6
    np.testing.assert_allclose(music, [0, 0, 0, 1], atol=0.02)  # near no concept: it stays
    _, share, near = text.before_attraction(["fire truck"])
    slow = plain[0] + ATTRACTION * near[0] * unit(share[0] @ directions)
    np.testing.assert_allclose(fire, slow / np.linalg.norm(slow), atol=1e-5)


@pytest.mark.parametrize(
    ("word", "other"),
    [("fire truck", "truck"), ("bus", "truck"), ("pedestrian", "cyclist"), ("garbage truck", "truck")],
)
def test_words_that_are_near_in_text_are_apart(model: Mini, word: str, other: str) -> None:
    one, two = model.embed_text([word, other])
    assert one @ two < 0.95  # above that a query takes both for one


def test_norms_folded_into_convolutions_change_nothing(model: Mini) -> None:
    """The quick network against the plain one, as it was trained."""
    import torch
    from safetensors.torch import load_file

    from upvl_cli.vlm.mini_network import MiniNetwork

    plain_network = MiniNetwork(model.dim).train(False)
    plain_network.load_state_dict(
        {k: v.float() for k, v in load_file(WEIGHTS / FILES[0]).items()}, strict=False
    )
    pixels = torch.tensor(np.random.default_rng(1).integers(0, 255, (1, 3, 96, 128))).float()
    with torch.inference_mode():
        full, quick = plain_network(pixels).numpy(), model._network(pixels).numpy()
    np.testing.assert_allclose(quick, full, atol=1e-3 * np.abs(full).max())


def test_concepts_have_a_name_each_in_their_order(model: Mini) -> None:
    names = (WEIGHTS / CONCEPTS).read_text(encoding="utf-8").splitlines()
    assert len(names) == len(set(names)) == model.text.concept_cosines(["car"]).shape[1]
    # The first word of nearly every concept is nearer to it than to any other.
    own = model.nearest_concepts(names, 1)
    assert sum(near[0][0] == name for near, name in zip(own, names, strict=True)) >= 0.9 * len(names)


def test_a_phrase_has_its_nearest_concepts(model: Mini) -> None:
    ((first, second), only) = model.nearest_concepts(["a sedan car", "motorway"], 2)
    assert first[1] >= second[1]
    assert only[0][0] == "road"
    assert model.nearest_concepts([], 2) == []


@pytest.mark.real
def test_streets_of_camvid_are_told_by_words(model: Mini, shared: Path) -> None:
    """A few pictures of the test split, which no training saw: most pixels get their word."""
    classes = (shared / "data/camvid/classes.txt").read_text().splitlines()[:11]
    words = model.embed_text(classes)
    right = total = 0
    for path in sorted((shared / "data/camvid/test").glob("*.jpg"))[::40]:
        label = np.asarray(Image.open(shared / "data/camvid/testannot" / f"{path.stem}.png"))
        features = model.embed_image(np.asarray(Image.open(path).convert("RGB")))
        named = (features @ words.T).argmax(axis=2)
        sides = zip(named.shape, label.shape, strict=True)
        rows, columns = (((np.arange(cells) + 0.5) * side / cells).astype(int) for cells, side in sides)
        centre = label[np.ix_(rows, columns)]
        right += ((named == centre) & (centre < 11)).sum()
        total += (centre < 11).sum()
    assert right / total > 0.85


def test_the_package_stays_small() -> None:
    assert sum((WEIGHTS / name).stat().st_size for name in FILES) <= 16 * 2**20


def test_models_are_named_with_their_weights() -> None:
    assert model_family("mini") == (MODELS["mini"], "")
    assert model_family("clip:/models/a:b") == (MODELS["clip"], "/models/a:b")
    with pytest.raises(BadSetting, match="unknown model 'clipp'; did you mean 'clip'"):
        model_family("clipp:/models/b16")
    with pytest.raises(BadSetting, match="mini brings its own weights"):
        MODELS["mini"].files("/models/mine")


@pytest.mark.parametrize("size", [(60, 20), (20, 60), (130, 12), (12, 12)])
def test_narrow_pictures_have_features_too(model: Mini, size: tuple[int, int]) -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)
    features = model.embed_image(rgb)
    np.testing.assert_allclose(np.linalg.norm(features, axis=-1), 1, atol=1e-3)
