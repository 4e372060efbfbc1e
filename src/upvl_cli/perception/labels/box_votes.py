"""Words of tracks by the 2D boxes that they are seen in: each frame votes with the confidence of its box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Floats, Ints


class TrackBoxWords(NamedTuple):
    """Words of some tracks.

    Attributes:
        word: (b,) name of the 2D boxes that has the most votes; empty without a vote.
        share: (b,) float32 share of the votes of the track that the word has, 0 without a vote.
        votes: (b,) float32 sum of the confidences of all 2D boxes of the track.
    """

    word: Array
    share: Floats
    votes: Floats


class BoxVotes:
    """Votes of 2D boxes for the words of tracks, counted frame by frame."""

    def __init__(self) -> None:
        """Start without a vote."""
        self._votes: dict[int, dict[str, float]] = {}

    def add_frame(self, track_id: Ints, name: Array, score: Floats) -> None:
        """Count the votes of one frame.

        Args:
            track_id: (b,) the track of each 3D box.
            name: (b,) name of the 2D box that it is seen in; empty for none.
            score: (b,) confidence of that 2D box: the weight of its vote.
        """
        for track, word, weight in zip(track_id.tolist(), name.tolist(), score.tolist(), strict=True):
            if word:
                votes = self._votes.setdefault(track, {})
                votes[word] = votes.get(word, 0.0) + weight

    def words(self, track_id: Ints) -> TrackBoxWords:
        """Return the word of each track; of equal ones the first in the alphabet.

        Args:
            track_id: (b,) tracks.
        """
        words: list[str] = []
        share, total = np.zeros(len(track_id), np.float32), np.zeros(len(track_id), np.float32)
        for row, track in enumerate(track_id.tolist()):
            votes = self._votes.get(track, {})
            total[row] = sum(votes.values())
            best = min(votes, key=lambda word: (-votes[word], word), default="")
            words.append(best)
            share[row] = votes[best] / total[row] if total[row] > 0 else 0.0
        return TrackBoxWords(np.array(words, dtype=np.str_), share, total)
