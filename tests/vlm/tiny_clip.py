"""Tiny true checkpoints of CLIP and SigLIP: a few numbers wide, random weights, saved by transformers itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, processors
from transformers import CLIPConfig, CLIPModel, PreTrainedTokenizerFast, SiglipConfig, SiglipModel

MEAN, STD = [0.4, 0.5, 0.6], [0.2, 0.25, 0.3]
WORDS = ["<pad>", "<start>", "<unknown>", "a", "photo", "of", "car", "tree", "red", ".", "<end>"]
CONTEXT = 12
IMAGE, PATCH = 32, 8  # a window of 4 x 4 patches
TEXT = {
    "vocab_size": len(WORDS),
    "hidden_size": 16,
    "intermediate_size": 24,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "max_position_embeddings": CONTEXT,
    "pad_token_id": 0,
    "bos_token_id": 1,
    "eos_token_id": len(WORDS) - 1,
}
VISION = {
    "hidden_size": 16,
    "intermediate_size": 24,
    "num_hidden_layers": 3,
    "num_attention_heads": 2,
    "image_size": IMAGE,
    "patch_size": PATCH,
}


def tiny_tokenizer() -> Tokenizer:
    """One token a word."""
    tokenizer = Tokenizer(
        models.WordLevel({word: at for at, word in enumerate(WORDS)}, unk_token="<unknown>")
    )
    tokenizer.normalizer = normalizers.Lowercase()
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    ends = [("<start>", WORDS.index("<start>")), ("<end>", WORDS.index("<end>"))]
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<start> $A <end>", pair=None, special_tokens=ends
    )
    return tokenizer


def save(model: Any, folder: Path) -> Any:
    """Write a checkpoint as a user has it, with all weights drawn anew: fresh ones are partly zero."""
    with torch.no_grad():
        for weight in model.parameters():
            weight.add_(0.3 * torch.randn(weight.shape))
    model.save_pretrained(folder)
    tokenizer_files(folder)
    return model.eval()


def tokenizer_files(folder: Path) -> None:
    """Write what a checkpoint has beside its weights."""
    PreTrainedTokenizerFast(
        tokenizer_object=tiny_tokenizer(),
        pad_token="<pad>",
        bos_token="<start>",
        eos_token="<end>",
        unk_token="<unknown>",
    ).save_pretrained(folder)
    preprocessor = {"image_mean": MEAN, "image_std": STD, "rescale_factor": 1 / 255}
    (folder / "preprocessor_config.json").write_text(json.dumps(preprocessor))


def clip(folder: Path) -> CLIPModel:
    """CLIP with a joint space of 10 numbers."""
    torch.manual_seed(5)
    return save(CLIPModel(CLIPConfig(text_config=TEXT, vision_config=VISION, projection_dim=10)), folder)


def siglip(folder: Path) -> SiglipModel:
    """SigLIP, whose image size is no whole number of patches, as in so400m-patch14-384."""
    torch.manual_seed(6)
    vision = VISION | {"image_size": IMAGE + 3}
    text = TEXT | {"projection_size": 16}
    return save(SiglipModel(SiglipConfig(text_config=text, vision_config=vision)), folder)
