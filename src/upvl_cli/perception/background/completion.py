"""The background state of points that no camera sees at the moment."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.place_memory import remember
from upvl_cli.perception.background.shape_classifier import Alike, Shapes, lessons
from upvl_cli.types import Array, Bools, Floats, Ints


@dataclass(frozen=True)
class Sighting:
    """What the cameras tell of the points of one sweep that stand above the ground.

    Attributes:
        background: (n,) 1 where a camera sees background, 0 where something else, `UNKNOWN` where none looks.
        is_fast: (n,) whether the point moves.
        xyz_world_m: (n, 3) where it is.
        shape: What surrounds it; None where looks are not asked for.
    """

    background: Ints
    is_fast: Bools
    xyz_world_m: Floats
    shape: Shapes | None


class Unseen:
    """Tells what no camera sees from what one saw: the same place at another time, or else what looks like it."""

    def __init__(self, sweeps: Iterable[Sighting]) -> None:
        """Learn from all sweeps of a drive, in order."""
        self._lessons: list[tuple[Floats, Ints]] = []
        self._memory = remember(self._known(sweeps))
        self._alike = Alike(self._lessons)

    def _known(self, sweeps: Iterable[Sighting]) -> Iterator[tuple[Floats, Bools]]:
        """What stands still and is seen, sweep by sweep; looks are noted on the way."""
        for seen in sweeps:
            if seen.shape is not None:
                self._lessons.append(lessons(seen.shape, seen.background))
            still = (seen.background != UNKNOWN) & ~seen.is_fast
            yield seen.xyz_world_m[still], seen.background[still] == 1

    def of(self, sweep: Sighting) -> Array:
        """(n,) int8 state of each point of a sweep: what moves unseen stays `UNKNOWN`."""
        state = np.array(sweep.background, dtype=np.int8)
        open_ = np.flatnonzero((state == UNKNOWN) & ~sweep.is_fast)
        state[open_] = self._memory.of(sweep.xyz_world_m[open_])
        if sweep.shape is not None:
            open_ = open_[state[open_] == UNKNOWN]
            state[open_] = self._alike.of(sweep.shape)[open_]
        return state
