"""Numbers for the frames of many drives, in a few arrays of one value a drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from upvl_cli.types import Ints


@dataclass(frozen=True)
class FrameNumbers:
    """Numbers of frames: first those to train on, drive after drive, then those of a check, which are held out.

    Of each drive the end is held out, as neighbouring frames are too much alike.

    Attributes:
        repeats: (D,) how many numbers each frame to train on has: it is drawn so many times an epoch.
        train_start: (D + 1,) first number of each drive's frames to train on, and how many numbers there are.
        held_out_start: (D + 1,) the same of its held-out frames, counted from 0.
        checked: How many of the held-out frames a check uses, spread evenly over all of them.
    """

    repeats: Ints
    train_start: Ints
    held_out_start: Ints
    checked: int

    @classmethod
    def of_lengths(cls, lengths: Ints, repeats: Ints, held_out: float, most_checked: int) -> Self:
        """Assign numbers to frames.

        Args:
            lengths: (D,) how many frames each drive has.
            repeats: (D,) as in the attributes.
            held_out: Share of each drive that is held out.
            most_checked: Largest number of frames of a check.
        """
        at_end = np.rint(held_out * np.asarray(lengths)).astype(np.int64)
        train_start = np.concatenate([[0], np.cumsum((lengths - at_end) * repeats, dtype=np.int64)])
        held_out_start = np.concatenate([[0], np.cumsum(at_end, dtype=np.int64)])
        return cls(repeats, train_start, held_out_start, min(int(held_out_start[-1]), most_checked))

    @property
    def train(self) -> int:
        """How many numbers of frames to train on there are; the frames of a check have those that follow."""
        return int(self.train_start[-1])

    def frame_of(self, number: int) -> tuple[int, int]:
        """Return the drive of a number, counted from 0, and which of its frames it is."""
        if number < self.train:
            drive = int(np.searchsorted(self.train_start, number, side="right")) - 1
            return drive, (number - int(self.train_start[drive])) // int(self.repeats[drive])
        held_out = (number - self.train) * int(self.held_out_start[-1]) // self.checked
        drive = int(np.searchsorted(self.held_out_start, held_out, side="right")) - 1
        first = int(self.train_start[drive + 1] - self.train_start[drive]) // int(self.repeats[drive])
        return drive, first + held_out - int(self.held_out_start[drive])
