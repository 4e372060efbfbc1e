"""Features kept small, and compared with words in the full space (UP-VL, Section 3.4; design in docs/design.md).

A basis is fitted once for all drives (incremental PCA; Ross et al., IJCV 2008). A feature f of length 1 is kept
as z = W (f - m), rounded to whole numbers of eight bits. With a word t it compares as cos(m + W' z, t), which
needs no more than m t + z (W t) and the length of m + W' z.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from upvl_cli.types import Array, Floats, Ints

KEPT = 64  # values of a feature (UP-VL, Section 4)
_LARGEST = 127


@dataclass(frozen=True)
class Basis:
    """Where features are kept.

    Attributes:
        mean: (d,) m.
        components: (KEPT, d) W; rows of zeros where the model has fewer dimensions.
        scale: (KEPT,) size of one step of each rounded value.
        variance_kept: Share of the variance that is kept, 0 to 1.
    """

    mean: Floats
    components: Floats
    scale: Floats
    variance_kept: float

    def kept(self, features: Array) -> Floats:
        """(..., KEPT) values of (..., d) features of any length; not rounded."""
        length = np.sqrt(np.einsum("...d,...d->...", features, features))[..., None]
        # W (f / |f| - m), in an order that makes no second array of full features.
        turned = features @ self.components.T / np.maximum(length, 1e-9)
        return np.asarray(turned - self.components @ self.mean, dtype=np.float32)

    def rounded(self, values: Floats) -> Ints:
        """(..., KEPT) int8 of values."""
        steps = values / np.where(self.scale > 0, self.scale, 1)
        return np.clip(np.rint(steps), -_LARGEST, _LARGEST).astype(np.int8)

    def values(self, codes: Ints) -> Floats:
        """(..., KEPT) values of what `rounded` gave."""
        return np.asarray(codes * self.scale, dtype=np.float32)

    def cosines(self, codes: Ints, words: Floats) -> Floats:
        """(n, t) cosine of each of (n, KEPT) rounded features with each of (t, d) words of length 1."""
        # Steps times W t, and as one word more steps times W m: a cosine costs little but its own products.
        with_mean = np.column_stack([words.T, self.mean])
        turned = (self.scale[:, None] * (self.components @ with_mean)).astype(np.float32)
        steps = codes.astype(np.float32)
        dot = steps @ turned + (self.mean @ with_mean).astype(np.float32)
        steps *= self.scale
        square = 2 * dot[:, -1] - self.mean @ self.mean + np.einsum("nk,nk->n", steps, steps)
        return np.asarray(dot[:, :-1] / np.sqrt(np.maximum(square, 1e-12))[:, None], dtype=np.float32)


def fit(batches: Iterable[Floats], dim: int) -> Basis:
    """Fit a basis to features.

    Args:
        batches: (n, d) features of any length, n at least `KEPT`; a few pictures at a time.
        dim: d.
    """
    rest = iter(batches)
    first = next(rest, None)
    largest = np.zeros(KEPT, dtype=np.float32)
    if first is None:
        return Basis(np.zeros(dim, np.float32), np.zeros((KEPT, dim), np.float32), largest, 0.0)
    from sklearn.decomposition import IncrementalPCA

    pca = IncrementalPCA(min(KEPT, dim))
    for features in chain([first], rest):
        direction = features / np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-9)
        pca.partial_fit(direction)
        # Of the axes so far: they settle after the first pictures, and what lies beyond is cut.
        reach = np.abs((direction - pca.mean_) @ pca.components_.T).max(axis=0)
        largest[: len(reach)] = np.maximum(largest[: len(reach)], reach)
    components = np.zeros((KEPT, dim), dtype=np.float32)
    components[: len(pca.components_)] = pca.components_
    return Basis(
        pca.mean_.astype(np.float32),
        components,
        (largest / _LARGEST).astype(np.float32),
        float(pca.explained_variance_ratio_.sum()),
    )


def background_score(cosines: Floats, against: Floats) -> Floats:
    """(n,) how much like background each feature is: the best background word less the best of the others.

    Args:
        cosines: (n, b) with the background words.
        against: (n, a) with the words that they are compared with; a may be 0.
    """
    score = cosines.max(axis=1, initial=-1)
    return np.asarray(score - against.max(axis=1) if against.shape[1] else score)
