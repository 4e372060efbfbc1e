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


def background_of_tracks(track: Ints, frames: Iterable[tuple[Ints, Ints, Ints]]) -> Floats:
    """Return (n,) share of background among the points of the track of each box; 0 where no state is known.

    The points of all frames of a track count alike: r_bg of UP-VL, taken of a track and not of a box.

    Args:
        track: (n,) track numbers of the boxes of all frames, in order.
        frames: For each frame (p,) the background state of its points, (p,) the proposal that each belongs to, -1
            for none, and (b,) the proposal of each of its boxes, -1 for a box that the tracker predicted.
    """
    known, hits = [np.zeros(0)], [np.zeros(0)]
    for state, proposal, box_proposal in frames:
        total = max(proposal.max(initial=-1), box_proposal.max(initial=-1)) + 1
        # The last place is that of no proposal: a predicted box has none, and some points neither.
        for counts, chosen in ((known, state >= 0), (hits, state == 1)):
            owner = proposal[chosen & (proposal >= 0)]
            counts.append(np.append(np.bincount(owner, minlength=total), 0)[box_proposal])
    _, number = np.unique(track, return_inverse=True)
    points = np.bincount(number, np.concatenate(known))
    return np.asarray((np.bincount(number, np.concatenate(hits)) / np.maximum(points, 1))[number])
