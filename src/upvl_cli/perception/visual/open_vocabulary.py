"""Features in a reduced space, and their cosines with words in the full space (UP-VL, Section 3.4).

One basis is fitted for all drives (incremental PCA; Ross et al., IJCV 2008). A feature f of length 1 is stored as
z = W (f - m), quantized to eight bits. Its cosine with a word t is cos(m + W^T z, t), which needs no more than
m t + z (W t) and the length of m + W^T z.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from upvl_cli.types import Array, Floats, Ints

COMPONENTS = 64  # of a stored feature (UP-VL, Section 4); the schema of the shards has this length
_MAX_CODE = 127  # int8, the same in both directions
# Axes whose singular value is a smaller share of the largest are rounding errors of float32: they depend on the
# machine and mean nothing. A model of few classes has features on few axes.
_MIN_SINGULAR = 1e-4


@dataclass(frozen=True)
class Basis:
    """The reduced space of features.

    Attributes:
        mean: (d,) mean m of the features, all of length 1.
        components: (COMPONENTS, d) principal axes W; rows of zeros where the features have fewer dimensions.
        scale: (COMPONENTS,) step of the quantization of each component.
        variance_kept: Share of the variance along the components, 0 to 1.
    """

    mean: Floats
    components: Floats
    scale: Floats
    variance_kept: float

    def project(self, features: Array) -> Floats:
        """Return (..., COMPONENTS) values z = W (f / |f| - m) of (..., d) features f."""
        length = np.sqrt(np.einsum("...d,...d->...", features, features))[..., None]
        # In an order that makes no second array of full features.
        projected = features @ self.components.T / np.maximum(length, 1e-9)
        return np.asarray(projected - self.components @ self.mean, dtype=np.float32)

    def quantize(self, values: Floats) -> Ints:
        """Return (..., COMPONENTS) int8 codes of values."""
        steps = values / np.where(self.scale > 0, self.scale, 1)
        return np.clip(np.rint(steps), -_MAX_CODE, _MAX_CODE).astype(np.int8)

    def dequantize(self, codes: Ints) -> Floats:
        """Return (..., COMPONENTS) values of codes."""
        return np.asarray(codes * self.scale, dtype=np.float32)

    def cosines(self, codes: Ints, words: Floats) -> Floats:
        """Return (n, t) cosines cos(m + W^T z, t) of features with words, in the full space.

        Args:
            codes: (n, COMPONENTS) int8 codes of the features.
            words: (t, d) vectors of length 1.
        """
        # |m + W^T z|^2 = 2 m (m + W^T z) - m m + z z as the rows of W are orthonormal: m is one word more.
        with_mean = np.column_stack([words.T, self.mean])
        projected = (self.scale[:, None] * (self.components @ with_mean)).astype(np.float32)
        steps = codes.astype(np.float32)
        dot = steps @ projected + (self.mean @ with_mean).astype(np.float32)
        steps *= self.scale
        square = 2 * dot[:, -1] - self.mean @ self.mean + np.einsum("nk,nk->n", steps, steps)
        return np.asarray(dot[:, :-1] / np.sqrt(np.maximum(square, 1e-12))[:, None], dtype=np.float32)

    def compact(self, values: Floats) -> Floats:
        """Return (n, COMPONENTS + 1) vectors of length 1 whose dot products are the cosines of the full features.

        With the mean split into its part W m along the axes and the rest r, the feature m + W^T z has the coordinates
        (W m + z, |r|) along the axes and r, in which angles are those of the full space.

        Args:
            values: (n, COMPONENTS) values z.
        """
        rest = float(np.linalg.norm(self._mean_rest))
        full = np.column_stack([values + self.components @ self.mean, np.full(len(values), rest)])
        return np.asarray(full / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-9), np.float32)

    def compact_words(self, words: Floats) -> Floats:
        """Return (t, COMPONENTS + 1) vectors whose dot products with those of `compact` are cosines with words.

        Args:
            words: (t, d) vectors of length 1.
        """
        rest = self._mean_rest
        along_rest = words @ rest / max(float(np.linalg.norm(rest)), 1e-9)
        return np.asarray(np.column_stack([words @ self.components.T, along_rest]), np.float32)

    @property
    def _mean_rest(self) -> Floats:
        return np.asarray(self.mean - self.components.T @ (self.components @ self.mean))


def fit(batches: Iterable[Floats], dim: int) -> Basis:
    """Fit the principal axes of features, batch by batch.

    Args:
        batches: (n, d) features of any length each, n at least `COMPONENTS`.
        dim: Length d of the features.
    """
    rest = iter(batches)
    first = next(rest, None)
    largest = np.zeros(COMPONENTS, dtype=np.float32)
    if first is None:
        return Basis(np.zeros(dim, np.float32), np.zeros((COMPONENTS, dim), np.float32), largest, 0.0)
    from sklearn.decomposition import IncrementalPCA

    pca = IncrementalPCA(min(COMPONENTS, dim))
    for features in chain([first], rest):
        direction = features / np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-9)
        pca.partial_fit(direction)
        # Along the axes of the batches so far, which change little after the first ones; larger values saturate.
        reach = np.abs((direction - pca.mean_) @ pca.components_.T).max(axis=0)
        largest[: len(reach)] = np.maximum(largest[: len(reach)], reach)
    components = np.zeros((COMPONENTS, dim), dtype=np.float32)
    components[: len(pca.components_)] = pca.components_
    rank = int((pca.singular_values_ > _MIN_SINGULAR * pca.singular_values_.max()).sum())
    components[rank:], largest[rank:] = 0, 0
    return Basis(
        pca.mean_.astype(np.float32),
        components,
        (largest / _MAX_CODE).astype(np.float32),
        float(pca.explained_variance_ratio_.sum()),
    )


def background_score(cosines: Floats, against: Floats) -> Floats:
    """Return (n,) how much like background each feature is: its best background word less the best of the others.

    Args:
        cosines: (n, b) with the background words.
        against: (n, a) with the words that they are compared with; a may be 0.
    """
    score = cosines.max(axis=1, initial=-1)
    return np.asarray(score - against.max(axis=1) if against.shape[1] else score)
