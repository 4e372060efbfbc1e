"""Puts both halves of `mini` into the package: python training/mini/pack.py TEXT NETWORK_FOLDER...

Of several networks that started from the same weights the mean is taken: it sees new pictures better than any one
of them (model soups, Wortsman et al., ICML 2022).
"""

from __future__ import annotations

import argparse
import shutil
import tomllib
from pathlib import Path

import numpy as np
import torch
from phrases import WORDS
from safetensors import numpy as numpy_file
from safetensors.torch import load_file, save_file
from text import as_int8

from upvl_cli.types import Array, Floats
from upvl_cli.vlm.mini import CONCEPTS, FILES, WEIGHTS
from upvl_cli.vlm.mini_text import ATTRACTION, MiniText, unit


def with_directions(text: Path, learned: Floats) -> dict[str, Array]:
    """Return the tables of the text half with the directions of the concepts: learned ones, and described ones."""
    tables = dict(numpy_file.load_file(text / "text.safetensors"))
    tables["directions"], tables["direction_scale"] = as_int8(learned)
    phrases = (text / "mini_phrases.txt").read_text(encoding="utf-8").split("\n")[:-1]
    half = MiniText(tables, phrases, text / "mini_tokenizer.json")
    directions = learned.copy()
    for row, concept in enumerate(tomllib.loads(WORDS.read_text(encoding="utf-8")).values()):
        if "described" in concept:
            towards = unit(half.embed(concept["described"]).mean(axis=0))
            plain = half.embed_plain(concept["words"]).mean(axis=0)
            # The direction that brings the mean of the words there, their own vectors included.
            along = float(towards @ plain)
            reach = along + (along**2 + ATTRACTION**2 - float(plain @ plain)) ** 0.5
            directions[row] = (reach * towards - plain) / ATTRACTION
    tables["directions"], tables["direction_scale"] = as_int8(directions)
    return tables


def main() -> None:
    """Write the files, and print their size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("text", type=Path)
    parser.add_argument("networks", type=Path, nargs="+")
    options = parser.parse_args()
    image, text, phrases, tokenizer = FILES
    all_weights = [load_file(folder / "network.safetensors") for folder in options.networks]
    kept = {
        name: torch.stack([weights[name] for weights in all_weights]).mean(dim=0).half()
        for name, value in all_weights[0].items()
        if value.is_floating_point()
    }
    save_file(kept, WEIGHTS / image)
    learned = [
        numpy_file.load_file(folder / "directions.safetensors")["directions"] for folder in options.networks
    ]
    numpy_file.save_file(with_directions(options.text, np.mean(learned, axis=0)), WEIGHTS / text)
    shutil.copyfile(options.text / "mini_phrases.txt", WEIGHTS / phrases)
    shutil.copyfile(options.text / "mini_tokenizer.json", WEIGHTS / tokenizer)
    shutil.copyfile(options.text / CONCEPTS, WEIGHTS / CONCEPTS)
    for name in (*FILES, CONCEPTS):
        print(f"{name} {(WEIGHTS / name).stat().st_size / 2**20:.2f} MiB")


if __name__ == "__main__":
    main()
