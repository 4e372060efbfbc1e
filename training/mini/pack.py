"""Puts both halves of `mini` into the package: python training/mini/pack.py TEXT NETWORK_FOLDER...

Of several networks that started from the same weights the mean is taken: it sees new pictures better than any one
of them (model soups, Wortsman et al., ICML 2022).
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from upvl_cli.vlm.mini import CONCEPTS, FILES, WEIGHTS


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
    shutil.copyfile(options.text / "text.safetensors", WEIGHTS / text)
    shutil.copyfile(options.text / "mini_phrases.txt", WEIGHTS / phrases)
    shutil.copyfile(options.text / "mini_tokenizer.json", WEIGHTS / tokenizer)
    shutil.copyfile(options.text / CONCEPTS, WEIGHTS / CONCEPTS)
    for name in (*FILES, CONCEPTS):
        print(f"{name} {(WEIGHTS / name).stat().st_size / 2**20:.2f} MiB")


if __name__ == "__main__":
    main()
