"""Masks over points: what moves, and what is background (UP-VL, Algorithm 1, lines 4 and 5)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import Basis, background_score
from upvl_cli.perception.visual.views import SEEN
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


def settled(background: Ints, is_fast: Bools, *, policy: str) -> Ints:
    """The mask with what words cannot tell: what moves is no background, and what no camera sees goes by a policy.

    Words alone lost every cyclist of a real drive with small pictures (docs/log.md).

    Args:
        background: (n,) as of `Background.of`.
        is_fast: (n,) whether each moves.
        policy: Of points without a feature: "drop" makes them background, "moving" those that stand; any other
            leaves them `UNKNOWN`.
    """
    dropped = (background == UNKNOWN) & (policy in ("drop", "moving"))
    if policy == "moving":
        dropped &= ~is_fast
    claimed = (background == 1) & is_fast
    return np.where(dropped, np.int8(1), np.where(claimed, np.int8(UNKNOWN), background))


def background_of_tracks(track: Ints, frames: Iterable[tuple[Ints, Ints, Ints]]) -> Floats:
    """(n,) share of background among the points of the track of each box, in all frames; 0 where nobody knows.

    Args:
        track: (n,) numbers of the tracks, of the boxes of all frames in order.
        frames: Of each frame (p,) the state of its points, as of `Background.of`, (p,) the proposal that each
            belongs to, -1 for none, and (b,) the proposal of each of its boxes, -1 for one that coasts.
    """
    known, hits = [np.zeros(0)], [np.zeros(0)]
    for state, proposal, of_box in frames:
        held = np.where(state >= 0, proposal, -1)
        total = max(proposal.max(initial=-1), of_box.max(initial=-1)) + 1
        # The last place is that of no proposal: a box that coasts has none, and some points neither.
        for counts, chosen in ((known, held), (hits, np.where(state == 1, proposal, -1))):
            counts.append(np.append(np.bincount(chosen[chosen >= 0], minlength=total), 0)[of_box])
    _, number = np.unique(track, return_inverse=True)
    points = np.bincount(number, np.concatenate(known))
    return np.asarray((np.bincount(number, np.concatenate(hits)) / np.maximum(points, 1))[number])
