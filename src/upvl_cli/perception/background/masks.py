"""Masks over points: what moves, and what is background (UP-VL, Algorithm 1, lines 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import Basis, background_score
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.types import Bools, Floats, Ints

UNKNOWN = -1


def moving(velocity_mps: Floats, *, min_speed_mps: float) -> Bools:
    """Return (n,) whether each point moves: M_sf = |F_sf| >= eps_sf (UP-VL, Algorithm 1, line 4).

    Args:
        velocity_mps: (n, 3) velocity over the ground.
        min_speed_mps: eps_sf; the paper takes 1.0 for moving objects and 0 for all motion states.
    """
    # As float32: half precision rounds 1.0 m/s along two axes to either side of the threshold.
    return np.asarray(np.linalg.norm(velocity_mps.astype(np.float32), axis=1) >= min_speed_mps)


@dataclass(frozen=True)
class BackgroundClassifier:
    """M_bg: whether a point looks like a background word (UP-VL, Algorithm 1, line 5), on the scale of its model.

    Attributes:
        basis: The reduced space of the features.
        words: (b, d) vectors of the background words C_bg.
        against: (a, d) vectors of the words that they are compared with; none in the paper.
        threshold: eps_bg: a point with this score or a higher one is background.
    """

    basis: Basis
    words: Floats
    against: Floats
    threshold: float

    def classify(self, state: Ints, codes: Ints) -> Ints:
        """Return (n,) int8: 1 background, 0 not, `UNKNOWN` without a feature.

        Args:
            state: (n,) visibility of each point, as in `views`.
            codes: (s, COMPONENTS) quantized features of the seen points.
        """
        background = np.full(len(state), UNKNOWN, dtype=np.int8)
        background[state == SEEN] = self.score(codes) >= self.threshold
        return background

    def score(self, codes: Ints) -> Floats:
        """Return (s,) how much like background each feature is."""
        cosines = self.basis.cosines(codes, np.concatenate([self.words, self.against]))
        return background_score(cosines[:, : len(self.words)], cosines[:, len(self.words) :])


def apply_motion_and_policy(
    background: Ints, is_moving: Bools, *, policy: str, moving_is_foreground: bool
) -> Ints:
    """Return the background state with motion and the policy for unseen points applied.

    Both are additions to UP-VL: words alone lost every cyclist of a real drive with small pictures (docs/log.md).

    Args:
        background: (n,) 1 background, 0 not, `UNKNOWN` for points without a feature.
        is_moving: (n,) whether each point moves.
        policy: Of points without a feature: "drop" makes them background, "moving" those that do not move; any
            other leaves them `UNKNOWN`.
        moving_is_foreground: Whether moving points are never background by words, but `UNKNOWN`.
    """
    dropped = (background == UNKNOWN) & (policy in ("drop", "moving"))
    if policy == "moving":
        dropped &= ~is_moving
    contradicted = (background == 1) & is_moving & moving_is_foreground
    return np.where(dropped, np.int8(1), np.where(contradicted, np.int8(UNKNOWN), background))
