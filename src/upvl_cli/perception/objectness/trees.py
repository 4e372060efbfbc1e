"""Gradient-boosted trees as plain arrays: what a file of safetensors holds, and a forest predicts with."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from upvl_cli.types import Array, Floats, Ints

_ARRAYS = ("feature", "threshold", "left", "right", "nan_left", "value", "root", "base")


@dataclass(frozen=True)
class Forest:
    """Trees whose leaves add up to the logit of a probability.

    Attributes:
        feature: (n,) feature that each node asks for, -1 for a leaf.
        threshold: (n,) values up to it go left.
        left: (n,) left child; itself for a leaf.
        right: (n,) right child; itself for a leaf.
        nan_left: (n,) 1 where an unknown value goes left.
        value: (n,) what a leaf adds.
        root: (t,) first node of each tree.
        base: (1,) logit before any tree.
        names: Names of the features.
        fitted_to: What the boxes that it was fitted to were made with.
    """

    feature: Ints
    threshold: Floats
    left: Ints
    right: Ints
    nan_left: Ints
    value: Floats
    root: Ints
    base: Floats
    names: tuple[str, ...]
    fitted_to: str

    def probability(self, features: Array) -> Array:
        """Return (m,) probabilities.

        Args:
            features: (m, f) features in the order of `names`; NaN for an unknown one.
        """
        rows = np.arange(len(features))[:, None]
        node = np.tile(self.root, (len(features), 1))
        while (self.feature[node] >= 0).any():
            asked = features[rows, np.maximum(self.feature[node], 0)]
            goes_left = np.where(np.isnan(asked), self.nan_left[node] == 1, asked <= self.threshold[node])
            node = np.where(goes_left, self.left[node], self.right[node])
        logit = self.base[0] + self.value[node].sum(axis=1)
        return np.asarray(1 / (1 + np.exp(-logit)))

    def to_bytes(self) -> bytes:
        """Return the trees as a file of safetensors."""
        metadata = {"names": json.dumps(self.names), "fitted_to": self.fitted_to}
        return save({name: np.ascontiguousarray(getattr(self, name)) for name in _ARRAYS}, metadata)

    @classmethod
    def from_bytes(cls, data: bytes) -> Forest:
        """Return the trees of a file of safetensors.

        Raises:
            ValueError: The bytes are no such file.
        """
        try:
            arrays = load(data)
            header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
            return cls(
                **{name: arrays[name] for name in _ARRAYS},
                names=tuple(json.loads(header["names"])),
                fitted_to=header["fitted_to"],
            )
        except (SafetensorError, KeyError, json.JSONDecodeError) as error:
            raise ValueError(f"no file of trees: {error}") from error
