"""Makes the text half of `mini` from all-MiniLM-L6-v2: python training/mini/text.py MODEL_FOLDER OUT_FOLDER.

Every token of the vocabulary and every phrase of the table gets the full model's vector: the mean of the last
layer's tokens, of the phrase alone and in a sentence of the street, so that "crane" is a machine. Their mean is
taken off, and the principal axes keep `DIM` of the dimensions.
"""

from __future__ import annotations

import argparse
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from phrases import WORDS, phrases
from safetensors.numpy import save_file
from transformers import AutoModel, AutoTokenizer

from upvl_cli.types import Array, Floats
from upvl_cli.vlm.mini import CONCEPTS
from upvl_cli.vlm.mini_text import MiniText, normalize, unit

DIM = 192
SENTENCES = ("{}", "a {} in the street")
BATCH = 256


def embed(folder: Path, texts: Sequence[str]) -> Floats:
    """(n, 384) what the full model makes of each text, over all sentences."""
    tokenizer, model = AutoTokenizer.from_pretrained(folder), AutoModel.from_pretrained(folder).eval()
    order = np.argsort([len(text) for text in texts])  # batches of equal length
    out = np.zeros((len(texts), model.config.hidden_size), dtype=np.float32)
    for first in range(0, len(texts), BATCH):
        of = order[first : first + BATCH]
        for sentence in SENTENCES:
            tokens = tokenizer([sentence.format(texts[i]) for i in of], padding=True, return_tensors="pt")
            with torch.inference_mode():
                hidden = model(**tokens).last_hidden_state
            kept = tokens["attention_mask"][..., None]
            out[of] += unit(((hidden * kept).sum(1) / kept.sum(1)).numpy()) / len(SENTENCES)
    return out


def as_int8(vectors: Array) -> tuple[Array, Array]:
    """(n, d) whole numbers and (n,) the scale of each row."""
    scale = np.abs(vectors).max(axis=1) / 127
    return np.rint(vectors / np.where(scale > 0, scale, 1)[:, None]).astype(np.int8), scale.astype(np.float32)


def concept_table(tables: dict[str, Array], phrases: Sequence[str], tokenizer: Path) -> dict[str, Array]:
    """Return the mean of the words of each concept; training gives it a direction of its own later on."""
    none = np.zeros((1, DIM), np.int8), np.zeros(1, np.float32)
    keys = ("concepts", "concept_scale"), ("directions", "direction_scale")
    empty = {name: value for pair in keys for name, value in zip(pair, none, strict=True)}
    text = MiniText(tables | empty, phrases, tokenizer)
    concepts = tomllib.loads(WORDS.read_text(encoding="utf-8")).values()
    means = as_int8(np.array([text.embed_plain(one["words"]).mean(axis=0) for one in concepts]))
    return {name: value for pair in keys for name, value in zip(pair, means, strict=True)}


def concept_names() -> list[str]:
    """Return the first word of each concept, in the order of `concept_table`: for people to read."""
    return [one["words"][0] for one in tomllib.loads(WORDS.read_text(encoding="utf-8")).values()]


def main() -> None:
    """Make the tables, and print how near the mean of tokens comes to the full model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table = list(dict.fromkeys(normalize(phrase) for phrase in phrases()))
    vocabulary = AutoTokenizer.from_pretrained(options.model).get_vocab()
    tokens = [token.removeprefix("##") for token, _ in sorted(vocabulary.items(), key=lambda item: item[1])]
    full = embed(options.model, [*tokens, *table])
    words = [place for place, token in enumerate(tokens) if token.isalpha() and len(token) > 2]
    mean = full[words].mean(axis=0)
    axes = np.linalg.svd(full[words] - mean, full_matrices=False)[2][:DIM]
    kept = (full - mean) @ axes.T
    token_codes, token_scale = as_int8(kept[: len(tokens)])
    phrase_codes, phrase_scale = as_int8(kept[len(tokens) :])
    tables = {
        "tokens": token_codes, "token_scale": token_scale, "phrases": phrase_codes, "phrase_scale": phrase_scale,
    }  # fmt: skip
    tables |= concept_table(tables, table, options.model / "tokenizer.json")
    save_file(tables, options.out / "text.safetensors")
    (options.out / "mini_phrases.txt").write_text("\n".join(table) + "\n", encoding="utf-8")
    (options.out / CONCEPTS).write_text("\n".join(concept_names()) + "\n", encoding="utf-8")
    shutil.copy(options.model / "tokenizer.json", options.out / "mini_tokenizer.json")
    text = MiniText(tables, table, options.out / "mini_tokenizer.json")
    alike = [text.embed_tokens(phrase) @ vector for phrase, vector in zip(table, text.vectors, strict=True)]
    print(f"{len(tokens)} tokens, {len(table)} phrases; likeness of the mean of tokens: {np.mean(alike):.3f}")


if __name__ == "__main__":
    main()
