"""Boxes of several hypotheses, and tracks that say the same in two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from upvl_cli.types import Bools, Ints


@dataclass(frozen=True)
class Hypotheses:
    """The hypotheses of n boxes.

    Attributes:
        number: (n,) number of the hypothesis of each box.
        duplicate_of: (n,) row of a box of an earlier hypothesis in the same frame with nearly the same points; -1 for
            none.
    """

    number: Ints
    duplicate_of: Ints

    @classmethod
    def one(cls, boxes: int) -> Self:
        """Return the single hypothesis of so many boxes."""
        return cls(np.zeros(boxes, dtype=np.int64), np.full(boxes, -1, dtype=np.int64))

    def duplicate_tracks(self, tracks: Sequence[Ints], max_share: float) -> Bools:
        """Return (k,) which tracks are left out: most of their boxes are those of one track of an earlier hypothesis.

        Args:
            tracks: The boxes of each, those of an earlier hypothesis first.
            max_share: Largest share of its boxes that a track may have in common with an earlier one.
        """
        is_duplicate = np.zeros(len(tracks), dtype=np.bool_)
        owner: Ints = np.full(len(self.number), -1, dtype=np.int64)
        for place, rows in enumerate(tracks):
            twin = self.duplicate_of[rows]
            shared = owner[twin[twin >= 0]]
            votes = np.bincount(shared[shared >= 0], minlength=1)
            is_duplicate[place] = votes.max() > max_share * len(rows)
            # Boxes of a third hypothesis may be duplicates of those of a track that was left out.
            owner[rows] = int(votes.argmax()) if is_duplicate[place] else place
        return is_duplicate
