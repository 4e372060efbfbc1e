"""Order of training frames: all of them in a new order each epoch, which follows from the seed alone.

The frames of an archive, drive after drive, are cut into chunks of consecutive frames. Each epoch takes the chunks in
a random order; some consecutive chunks of that order are a window, whose frames are taken in a random order. So only
the drives of a window are read at a time, and only the order of one window is ever in memory. An archive of no more
frames than one window has is shuffled as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from upvl_cli.detector.config import ShuffleConfig
from upvl_cli.detector.data.permutation import permuted
from upvl_cli.types import Ints

# Each purpose has random numbers of its own, so that no draw changes another.
_ORDER, _CHANGES, _CHUNKS = 0, 1, 2
_ROUNDS = 8  # of the Feistel network; four are enough for large archives (Luby and Rackoff, 1988), not for small ones


@dataclass(frozen=True)
class FrameOrder:
    """The endless order of the training frames.

    Attributes:
        frames: How many frames there are; from 1 on.
        seed: Seed of the order.
        shuffle: Sizes of chunks and windows.
    """

    frames: int
    seed: int
    shuffle: ShuffleConfig

    def frame_at(self, index: int) -> int:
        """Return the frame at an index of the order.

        Args:
            index: From 0 on; a step of b frames takes b of them.
        """
        length = self.shuffle.chunk_frames
        epoch, place = divmod(index, self.frames)
        chunks, rest = divmod(self.frames, length)  # the last frames, fewer than a chunk, stay at the end
        window, first, end = self._window(min(place // length, chunks - 1), chunks)
        size = (end - first) * length + (rest if end == chunks else 0)
        order = _window_order(self.seed, epoch, window, size)
        chunk, offset = divmod(first * length + int(order[place - first * length]), length)
        if chunk < chunks and end - first < chunks:  # else all is one window
            chunk = permuted(chunk, chunks, _keys(self.seed, epoch))
        return chunk * length + offset

    def _window(self, chunk: int, chunks: int) -> tuple[int, int, int]:
        """Return the number of the window of a chunk of the order, its first chunk, and the one after its last.

        Windows have nearly equal sizes, from that of the settings to less than two of them: a small last window would
        be a few drives alone.
        """
        windows = max(chunks // self.shuffle.window_chunks, 1)
        window = ((chunk + 1) * windows - 1) // chunks if chunks else 0
        return window, window * chunks // windows, (window + 1) * chunks // windows


def generator_at(index: int, seed: int) -> np.random.Generator:
    """Return the random numbers for the changes at one index of the order."""
    return np.random.default_rng([seed, _CHANGES, index])


@lru_cache(maxsize=4)
def _window_order(seed: int, epoch: int, window: int, size: int) -> Ints:
    return np.random.default_rng([seed, _ORDER, epoch, window]).permutation(size)


@lru_cache(maxsize=4)
def _keys(seed: int, epoch: int) -> tuple[int, ...]:
    keys = np.random.default_rng([seed, _CHUNKS, epoch]).integers(0, 2**64, _ROUNDS, dtype=np.uint64)
    return tuple(keys.tolist())
