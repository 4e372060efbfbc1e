"""Masks over points: what moves, and what is background (UP-VL, Algorithm 1, lines 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.algorithms.open_vocabulary import Basis, background_score
from upvl_cli.algorithms.views import SEEN
from upvl_cli.types import Bools, Floats, Ints

UNKNOWN = -1


def moving(velocity_mps: Floats, *, min_speed_mps: float) -> Bools:
    """(n,) whether each point moves: M_sf = |F_sf| >= eps_sf.

    Args:
        velocity_mps: (n, 3) velocity over the ground.
        min_speed_mps: eps_sf; the paper takes 1.0 for moving objects and 0 for all motion states.
    """
    # As float32: half precision rounds 1.0 m/s along two axes to either side of the threshold.
    return np.asarray(np.linalg.norm(velocity_mps.astype(np.float32), axis=1) >= min_speed_mps)


@dataclass(frozen=True)
class Background:
    """M_bg: whether a point looks like a background word, on the cosine scale of its model.

    Attributes:
        basis: Where features are kept.
        words: (b, d) vectors of the background words C_bg.
        against: (a, d) vectors of the words that they are compared with; none in the paper.
        eps: From this score on a point is background: eps_bg.
    """

    basis: Basis
    words: Floats
    against: Floats
    eps: float

    def of(self, state: Ints, feature: Ints) -> Ints:
        """(n,) int8: 1 background, 0 not, `UNKNOWN` without a feature.

        Args:
            state: (n,) of each point, as in `views`.
            feature: (s, KEPT) rounded features of those that are seen.
        """
        background = np.full(len(state), UNKNOWN, dtype=np.int8)
        background[state == SEEN] = self.score(feature) >= self.eps
        return background

    def score(self, feature: Ints) -> Floats:
        """(s,) how much like background each feature is."""
        cosines = self.basis.cosines(feature, np.concatenate([self.words, self.against]))
        return background_score(cosines[:, : len(self.words)], cosines[:, len(self.words) :])


def without_feature(background: Ints, is_fast: Bools, *, policy: str) -> Ints:
    """The mask with a decision on the points that no camera sees: neither background nor not, by what is seen.

    Args:
        background: (n,) as of `Background.of`.
        is_fast: (n,) whether each moves.
        policy: "drop" makes them background, "moving" those that stand; any other leaves them `UNKNOWN`.
    """
    dropped = (background == UNKNOWN) & (policy in ("drop", "moving"))
    if policy == "moving":
        dropped &= ~is_fast
    return np.where(dropped, np.int8(1), background)
