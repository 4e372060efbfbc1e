"""CPU seconds of one core for one picture, model by model: python bench/vl_models.py [MODEL ...].

Without a checkpoint: `mini`, and CLIP and SigLIP of the usual base size with random weights, which cost the same as
trained ones. MODEL is any value of `model` in vlm.toml.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ["UPVL_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "vlm"))

import numpy as np
import tiny_clip
import torch
from transformers import CLIPConfig, CLIPModel, SiglipConfig, SiglipModel

from upvl_cli.vlm import model_family

SIZE = (375, 1242, 3)
BASE = {
    "hidden_size": 768,
    "intermediate_size": 3072,
    "num_hidden_layers": 12,
    "num_attention_heads": 12,
    "patch_size": 16,
}


def random_base(folder: Path, image: int) -> tuple[str, str]:
    """Write CLIP and SigLIP with vision towers ViT-B/16 and tiny text towers; returns their values of `model`."""
    vision = BASE | {"image_size": image}
    text = tiny_clip.TEXT | {"projection_size": 768}
    for name, model in (
        ("clip", CLIPModel(CLIPConfig(text_config=text, vision_config=vision, projection_dim=512))),
        ("siglip", SiglipModel(SiglipConfig(text_config=text, vision_config=vision))),
    ):
        (folder / name).mkdir(parents=True)
        model.save_pretrained(folder / name)
        tiny_clip.tokenizer_files(folder / name)
    return f"clip:{folder / 'clip'}", f"siglip:{folder / 'siglip'}"


def main() -> None:
    """Print a line a model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="*")
    parser.add_argument("--pictures", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rgb = np.random.default_rng(0).integers(0, 256, SIZE, dtype=np.uint8)
    with tempfile.TemporaryDirectory() as scratch:
        models = options.models or ["mini", *random_base(Path(scratch), 224)]
        for value in models:
            family, weights = model_family(value)
            model = family.open(weights)
            features = model.embed_image(rgb)  # loads the network
            started = time.process_time()
            for _ in range(options.pictures):
                model.embed_image(rgb)
            seconds = (time.process_time() - started) / options.pictures
            print(
                json.dumps({"model": value, "seconds": round(seconds, 2), "shape": features.shape}),
                flush=True,
            )


if __name__ == "__main__":
    main()
