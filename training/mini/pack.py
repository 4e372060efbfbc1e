"""Puts both halves of `mini` into the package: python training/mini/pack.py TEXT NETWORK_FOLDER."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from safetensors.torch import load_file, save_file

from upvl_cli.vlm.mini import FILES, WEIGHTS


def main() -> None:
    """Write the files, and print their size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("text", type=Path)
    parser.add_argument("network", type=Path)
    options = parser.parse_args()
    image, text, phrases, tokenizer = FILES
    weights = load_file(options.network / "network.safetensors")
    kept = {name: value.half() for name, value in weights.items() if value.is_floating_point()}
    save_file(kept, WEIGHTS / image)
    shutil.copyfile(options.text / "text.safetensors", WEIGHTS / text)
    shutil.copyfile(options.text / "mini_phrases.txt", WEIGHTS / phrases)
    shutil.copyfile(options.text / "mini_tokenizer.json", WEIGHTS / tokenizer)
    for name in FILES:
        print(f"{name} {(WEIGHTS / name).stat().st_size / 2**20:.2f} MiB")


if __name__ == "__main__":
    main()
