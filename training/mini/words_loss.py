"""The loss of pixels over words, with the words of each concept drawn anew for each step."""

from __future__ import annotations

import numpy as np
import torch
from concepts import NEUTRAL, NOUNS, Concepts, Labels, Phrases
from crops import Batch
from phrases import COLOURS
from pictures import NONE, Object
from torch import Tensor, nn
from torch.nn import functional

from upvl_cli.types import Bools, Floats
from upvl_cli.vlm.mini_text import ATTRACTION

TAU = 0.05
PIXELS = 4000  # of each crop that are asked
LEAST_PIXELS = 25  # asked of an object whose kinds of ImageNet are taught
WEIGHTS = {
    "named": 1.0,
    "class": 1.0,
    "may": 0.4,
    "camvid": 0.5,
    "angle": 0.5,
    "kin": 0.5,
    "colour": 0.25,
    "kinds": 0.2,
}
STREET_SHARE = 0.3  # of ImageNet's shares of an object that its concepts must have


class WordLoss(nn.Module):
    """Cross-entropy of pixels over words.

    The directions that attract words are trained, too: the text half keeps them, so that words that are near in text
    and far in pictures part.
    """

    def __init__(
        self,
        concepts: Concepts,
        labels: Labels,
        counts: Floats,
        objects: list[Object],
        of_imagenet: Bools,
        seed: int,
    ):
        super().__init__()
        self.rng = np.random.default_rng(seed)
        every = [concepts.phrases(list(one["words"])) for one in concepts.table.values()]
        self.first = np.cumsum([0, *(len(one.plain) for one in every)])
        self._keep("words", Phrases(*(np.concatenate(parts) for parts in zip(*every, strict=True))))
        self._keep("neutral", concepts.phrases(list(NEUTRAL)))
        self._keep("coloured", concepts.coloured)
        self._keep("parents", concepts.phrases(concepts.parents))
        self.directions = nn.Parameter(torch.tensor(concepts.text.concepts.copy()))
        self.register_buffer("start", torch.tensor(concepts.text.concepts.copy()))
        for name, value in (
            ("shows", labels.concepts),
            ("classes", labels.classes),
            ("camvid", labels.camvid),
            ("kin", labels.parents),
        ):
            self.register_buffer(name, torch.tensor(value))
        self.class_rows = [concepts.names.index(name) for name in concepts.class_concepts]
        self.camvid_rows = [concepts.names.index(name) for name in concepts.camvid_concepts]
        self.register_buffer("weight", torch.tensor(_weights(counts, labels)))
        self.register_buffer("colour_of", torch.tensor([NONE, *(one.coloured for one in objects)]))
        self._kinds(objects, of_imagenet, concepts)

    def _keep(self, name: str, phrases: Phrases) -> None:
        for part, value in zip(phrases._fields, phrases, strict=True):
            self.register_buffer(f"{name}_{part}", torch.tensor(value))

    def _kinds(self, objects: list[Object], of_imagenet: Bools, concepts: Concepts) -> None:
        """Keep the shares of the concepts that ImageNet has, of objects that are one of them to both teachers.

        ImageNet has no car, lorry or bus as such: a bus is to it a "moving van". What the detector's class may not
        show is left out.
        """
        self.kind_rows = np.flatnonzero(of_imagenet.any(axis=1)).tolist()
        shares = np.zeros((len(objects) + 1, len(self.kind_rows)), dtype=np.float32)
        for row, one in enumerate(objects, start=1):
            if one.share is not None:
                shares[row] = (of_imagenet @ one.share * concepts.may_show(one.class_))[self.kind_rows]
        total = shares.sum(axis=1, keepdims=True)
        self.register_buffer(
            "kind_shares", torch.tensor(np.where(total > STREET_SHARE, shares / np.maximum(total, 1e-6), 0))
        )

    def phrases(self, name: str, rows: Tensor | None = None) -> Tensor:
        """Return attracted phrases, as `MiniText.embed` does."""
        plain, share, near = (getattr(self, f"{name}_{part}") for part in Phrases._fields)
        if rows is not None:
            plain, share, near = plain[rows], share[rows], near[rows]
        towards = functional.normalize(share @ functional.normalize(self.directions, dim=1), dim=1)
        return functional.normalize(plain + ATTRACTION * near[:, None] * towards, dim=1)

    def forward(self, features: Tensor, batch: Batch) -> dict[str, Tensor]:
        """Return the parts of the loss of (n, d, h / 4, w / 4) features, unweighted."""
        count, device = len(features), features.device
        place = torch.rand(count, PIXELS, 2, device=device) * 2 - 1
        at = functional.grid_sample(features, place[:, None], align_corners=False, padding_mode="border")[
            :, :, 0
        ]
        pixel = functional.normalize(at.transpose(1, 2), dim=2).flatten(0, 1)
        height, width = batch.label.shape[1:]
        row = ((place[..., 1] + 1) / 2 * height).long().clamp(max=height - 1)
        column = ((place[..., 0] + 1) / 2 * width).long().clamp(max=width - 1)
        index = row * width + column
        label = torch.gather(batch.label.flatten(1), 1, index).flatten()
        object_ = torch.gather(batch.object_.flatten(1), 1, index)
        chance = self.rng.random(len(self.first) - 1)
        spread = self.rng.integers(self.first[1:] - self.first[:-1])
        drawn = torch.tensor(self.first[:-1] + np.where(chance < 0.4, 0, spread), device=device)
        words = self.phrases("words", drawn)
        every = torch.cat([words, self.phrases("neutral")])
        parts = self._of_labels(pixel, label, words, every)
        parts |= self._of_colours(pixel, self.colour_of[object_.flatten()])
        parts["kinds"] = self._of_kinds(pixel.reshape(count, PIXELS, -1), object_)
        parts["stay"] = (functional.normalize(self.directions, dim=1) - self.start).square().sum(1).mean()
        return parts

    def _of_labels(self, pixel: Tensor, label: Tensor, words: Tensor, every: Tensor) -> dict[str, Tensor]:
        similarity = pixel @ every.T / TAU
        log_share = functional.log_softmax(similarity, dim=1)[:, : len(words)]
        shows, weight = self.shows[label], self.weight[label]
        may = _within(log_share, shows)
        is_real, of_camvid = self.classes[label].any(1), self.camvid[label].any(1)
        one = shows.sum(1) == 1
        made = one & ~self.classes[label].any(1)
        classes = functional.log_softmax(similarity[:, self.class_rows], dim=1)
        eleven = functional.log_softmax(similarity[:, self.camvid_rows], dim=1)
        concept = shows.float().argmax(1)
        angle = 1 - (pixel * words[concept]).sum(1)
        kin = self.kin[label]
        known = ~kin.isnan()
        parents = functional.binary_cross_entropy_with_logits(
            (pixel @ self.phrases("parents").T - 0.35) / 0.1, kin.nan_to_num(), reduction="none"
        )
        kin_loss = (parents * known).sum(1) / known.sum(1).clamp(min=1)
        return {
            "named": _mean(-may, weight, made),
            "class": _mean(-_within(classes, self.classes[label]), weight, is_real),
            "may": _mean(-may, weight, shows.any(1) & ~made),
            "camvid": _mean(-_within(eleven, self.camvid[label]), weight, of_camvid),
            "angle": _mean(angle, weight, made),
            "kin": _mean(kin_loss, weight, known.any(1)),
        }

    def _of_colours(self, pixel: Tensor, coloured: Tensor) -> dict[str, Tensor]:
        asked = coloured >= 0
        words = self.phrases("coloured").reshape(len(NOUNS), len(COLOURS), -1)
        noun, colour = coloured[asked] // len(COLOURS), coloured[asked] % len(COLOURS)
        similarity = torch.einsum("nd,mcd->nmc", pixel[asked], words) / TAU
        of_noun = similarity[torch.arange(len(noun), device=noun.device), noun]
        loss = functional.cross_entropy(of_noun, colour, reduction="none")
        return {"colour": loss.sum() / max(len(loss), 1)}

    def _of_kinds(self, pixel: Tensor, object_: Tensor) -> Tensor:
        """Return how far the mean feature of each object is from the teacher's shares of the concepts of ImageNet."""
        crop = torch.arange(len(pixel), device=pixel.device)[:, None].expand_as(object_)
        taught = self.kind_shares[object_].any(-1)
        key = crop[taught] * len(self.kind_shares) + object_[taught]
        if not len(key):
            return pixel.sum() * 0
        found, place, count = torch.unique(key, return_inverse=True, return_counts=True)
        mean = torch.zeros(len(found), pixel.shape[-1], device=pixel.device).index_add_(
            0, place, pixel[taught]
        )
        kept = count >= LEAST_PIXELS
        words = self.phrases("words", torch.tensor(self.first[self.kind_rows], device=pixel.device))
        log_share = functional.log_softmax(functional.normalize(mean[kept], dim=1) @ words.T / TAU, dim=1)
        shares = self.kind_shares[found[kept] % len(self.kind_shares)]
        return -(shares * log_share).sum() / max(int(kept.sum()), 1)


def _within(log_share: Tensor, allowed: Tensor) -> Tensor:
    return torch.logsumexp(log_share.masked_fill(~allowed, -1e4), dim=1)


def _mean(loss: Tensor, weight: Tensor, where: Tensor) -> Tensor:
    weight = weight * where
    return (loss * weight).sum() / weight.sum().clamp(min=1e-3)


def _weights(counts: Floats, labels: Labels) -> Floats:
    """Return the weight of each label: rare ones of real pictures, and of the city, count more."""
    weight = np.zeros(len(counts), dtype=np.float32)
    for group in (labels.classes.any(axis=1), ~labels.classes.any(axis=1)):
        group = group & labels.concepts.any(axis=1)
        share = counts[group] / max(counts[group].sum(), 1)
        rare = 1 / np.sqrt(np.maximum(share, 1e-4))
        weight[group] = np.clip(rare / np.average(rare, weights=np.maximum(share, 1e-9)), 0.3, 5)
    return weight
