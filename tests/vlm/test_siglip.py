"""What SigLIP has and CLIP has not: its tokenizers, its pooling head, its variants. The rest is in test_clip."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("transformers", reason="needs the extra clip")

import tiny_clip
import torch
from tiny_clip import CONTEXT, IMAGE
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, processors
from torch.nn import functional

from upvl_cli.errors import BadInput
from upvl_cli.vlm import model_family
from upvl_cli.vlm.siglip import Siglip, files


def sentencepiece_tokenizer(folder: Path) -> None:
    """Replace the tokenizer by one as SigLIP's checkpoints have it: spiece.model, no tokenizer.json."""
    sentencepiece = pytest.importorskip("sentencepiece", reason="needs the extra clip")
    pieces = io.BytesIO()
    sentencepiece.SentencePieceTrainer.train(
        sentence_iterator=iter(["a photo of a red car", "two trees near a fire truck"] * 9),
        model_writer=pieces, vocab_size=24, unk_id=2, eos_id=1, pad_id=0, bos_id=-1, minloglevel=2,
        hard_vocab_limit=False,
    )  # fmt: skip
    (folder / "tokenizer.json").unlink()
    (folder / "spiece.model").write_bytes(pieces.getvalue())
    (folder / "tokenizer_config.json").write_text(json.dumps({"tokenizer_class": "SiglipTokenizer"}))


def gemma_tokenizer(folder: Path) -> None:
    """Replace the tokenizer by one as SigLIP 2's checkpoints have it: Gemma's tokenizer.json, which keeps case."""
    words = ["<pad>", "<eos>", "<bos>", "<unk>", *sorted("▁.acdefhioprtu")]
    tokenizer = Tokenizer(
        models.BPE({word: at for at, word in enumerate(words)}, [], unk_token="<unk>", fuse_unk=True)
    )
    tokenizer.normalizer = normalizers.Replace(" ", "▁")
    tokenizer.pre_tokenizer = pre_tokenizers.Split(" ", "merged_with_previous")
    tokenizer.post_processor = processors.TemplateProcessing(
        single="$A <eos>", pair=None, special_tokens=[("<eos>", 1)]
    )
    tokenizer.save(str(folder / "tokenizer.json"))
    card = {"tokenizer_class": "GemmaTokenizer", "add_bos_token": False, "add_eos_token": True}
    special = {"pad_token": "<pad>", "eos_token": "<eos>", "bos_token": "<bos>", "unk_token": "<unk>"}
    (folder / "tokenizer_config.json").write_text(json.dumps(card | special))


@pytest.fixture
def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Any]:
    """A checkpoint with room for 40 tokens, and the library's own model of it."""
    monkeypatch.setattr(tiny_clip, "TEXT", tiny_clip.TEXT | {"vocab_size": 40, "max_position_embeddings": 40})
    return tmp_path, tiny_clip.siglip(tmp_path)


def library_vectors(model: Any, tokens: Any) -> np.ndarray:
    with torch.inference_mode():
        vectors = model.get_text_features(torch.tensor(tokens)).pooler_output
        return functional.normalize(vectors, dim=-1).numpy()


def test_sentencepiece_words_are_the_librarys(saved: tuple[Path, Any]) -> None:
    folder, model = saved
    sentencepiece_tokenizer(folder)
    from transformers import SiglipTokenizer

    tokenizer = SiglipTokenizer.from_pretrained(folder)
    tokens = tokenizer(["a photo of a Red CAR!"], padding="max_length", max_length=40)["input_ids"]
    assert tokens == tokenizer(["a photo of a red car"], padding="max_length", max_length=40)["input_ids"]
    vectors = Siglip(str(folder)).embed_text(["Red CAR!", "tree"])
    np.testing.assert_allclose(vectors[:1], library_vectors(model, tokens), atol=1e-6)
    assert np.abs(vectors[0] - vectors[1]).max() > 0.01


def test_gemma_words_are_lower_case_and_filled_up_at_the_right(saved: tuple[Path, Any]) -> None:
    folder, model = saved
    gemma_tokenizer(folder)
    tokenizer = Tokenizer.from_file(str(folder / "tokenizer.json"))
    ids = tokenizer.encode("a photo of a car.").ids
    assert len(ids) == 18 and ids[-1] == 1 and 3 not in ids  # 17 letters, the end, none unknown
    expected = library_vectors(model, [ids + [0] * (40 - len(ids))])
    np.testing.assert_allclose(Siglip(str(folder)).embed_text(["Car"]), expected, atol=1e-6)


def test_an_even_head_without_mlp_gives_the_mean_of_the_patches(tmp_path: Path) -> None:
    """With queries of zeros the library's head weighs all patches alike; it is linear but for its MLP."""
    model = tiny_clip.siglip(tmp_path)
    head = model.vision_model.head
    width = model.config.vision_config.hidden_size
    with torch.no_grad():
        head.attention.in_proj_weight[:width] = 0
        head.attention.in_proj_bias[:width] = 0
        head.mlp.fc2.weight.zero_()
        head.mlp.fc2.bias.zero_()
    model.save_pretrained(tmp_path)
    tower = Siglip(str(tmp_path))._image
    tokens = torch.randn(2, tower.cells**2, width)
    with torch.inference_mode():
        expected = head(tokens)
        np.testing.assert_allclose(tower._head_values(tokens).mean(1), expected, atol=1e-5)


def test_a_longer_text_is_cut(tmp_path: Path) -> None:
    tiny_clip.siglip(tmp_path)
    vlm = Siglip(str(tmp_path))
    assert vlm.embed_text(["car " * 3 * CONTEXT]).shape == (1, vlm.dim)
    assert vlm.name == f"siglip:{tmp_path}"


def test_its_family_opens_it(tmp_path: Path) -> None:
    tiny_clip.siglip(tmp_path)
    family, weights = model_family(f"siglip:{tmp_path}")
    assert family.files(weights) == files(str(tmp_path))
    assert family.open(weights).embed_image(np.zeros((IMAGE, IMAGE, 3), np.uint8)).shape == (4, 4, 16)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("clip", 'expected siglip; for CLIP write model = "clip:FOLDER"'),
        ("siglip2", "NaFlex.*of a fixed size"),
        ("blip", "expected siglip$"),
    ],
)
def test_another_kind_is_one_clear_line(tmp_path: Path, kind: str, message: str) -> None:
    tiny_clip.siglip(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps({"model_type": kind}))
    with pytest.raises(BadInput, match=message) as failure:
        Siglip(str(tmp_path))
    assert "\n" not in str(failure.value)


def test_a_folder_without_tokenizer_is_one_clear_line(tmp_path: Path) -> None:
    tiny_clip.siglip(tmp_path)
    (tmp_path / "tokenizer.json").unlink()
    with pytest.raises(BadInput, match=r"lacks tokenizer.json or vocab.json or spiece.model"):
        files(str(tmp_path))


def test_no_folder_names_the_setting() -> None:
    with pytest.raises(BadInput, match='model = "siglip:": there is no folder'):
        files("")
