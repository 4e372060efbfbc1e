"""The frames of many drives to learn from; no more than some are in memory at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from upvl_cli.detector.augment import augmented
from upvl_cli.detector.batch import Grid, Sample
from upvl_cli.detector.sampler import chance, item
from upvl_cli.detector.sweeps import Route, Scene, scene
from upvl_cli.types import Array, Floats, Ints, Points

_OPEN_DRIVES = 16  # each holds a few files open
_SCENES = 64  # at hand, of some 10 MB each: a small set is read from disk once, a large one streams


@dataclass(frozen=True)
class Source:
    """Where the frames of a drive are from, by the number of a frame.

    Attributes:
        route: Its sweeps, in time and space.
        sweep: Points of a frame.
        seen: The points that a camera sees, (c,), and their features, (c, 64) int8.
        labels: (m, 7) auto labels in ego axes, and their (m, 3) velocities.
    """

    route: Route
    sweep: Callable[[int], Points]
    seen: Callable[[int], tuple[Ints, Ints]]
    labels: Callable[[int], tuple[Floats, Floats]]


class DriveFrames:
    """The frames of drives, by number: first those to learn from, then those held out (`training.Frames`)."""

    def __init__(
        self,
        lengths: Mapping[str, int],
        source: Callable[[str], Source],
        *,
        grid: Grid,
        values: Callable[[Ints], Floats],
        held_out: float,
        paste: int,
        seed: int,
    ) -> None:
        """Number the frames.

        Args:
            lengths: How many frames each drive has.
            source: Opens a drive.
            grid: What the network sees.
            values: Gives the kept values of features.
            held_out: Share of each drive, its end: frames beside each other are too much alike to be parted.
            paste: Objects of another frame that are tried in each.
            seed: Of all chance.
        """
        self._source = lru_cache(maxsize=_OPEN_DRIVES)(source)
        self._scene = lru_cache(maxsize=_SCENES)(self._made)
        self._grid, self._values, self._paste, self._seed = grid, values, paste, seed
        cut = {drive: length - round(held_out * length) for drive, length in lengths.items()}
        learned = [(drive, place) for drive, end in cut.items() for place in range(end)]
        rest = [(drive, place) for drive, end in cut.items() for place in range(end, lengths[drive])]
        self._places = learned + rest
        self.train, self.held_out = len(learned), len(rest)

    def plain(self, number: int) -> Sample:
        """Give a frame as it is, with the same points to learn features from each time."""
        return self._scene(number).sample(self._grid, self._values, chance(number, self._seed))

    def changed(self, at: int, found: Mapping[int, Array]) -> Sample:
        """Give the frame at a place of the order, with the chance of that place.

        The objects that are set into it are from the frame after it, which is then at hand for the next place.
        """
        rng, number = chance(at, self._seed), item(at, self.train, self._seed)
        here = self._scene(number)
        if number in found:
            more = found[number]
            here = replace(
                here,
                boxes=np.concatenate([here.boxes, more]),
                velocity_mps=np.concatenate([here.velocity_mps, np.zeros((len(more), 3))]),
            )
        donor = self._scene(item(at + 1, self.train, self._seed)) if self._paste else here
        return augmented(here, donor, rng, paste=self._paste).sample(self._grid, self._values, rng)

    def _made(self, number: int) -> Scene:
        drive, place = self._places[number]
        source = self._source(drive)
        frame = source.route.frames[place]
        boxes, velocity_mps = source.labels(frame)
        boxes = boxes - np.eye(7)[2] * source.route.ground_z_m
        return scene(
            source.route.points(place, source.sweep),
            *source.seen(frame),
            np.ascontiguousarray(boxes),
            velocity_mps,
        )
