"""A part of a drive that is small enough to be checked in seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from upvl_cli.types import Array, Camera, Frame, Image, Points


@dataclass(frozen=True)
class DriveSample:
    """Sweeps and pictures of a few moments of a drive, and what the drive says of all its frames.

    A `step` is the place of a frame in `frames`, from 0 on.

    Attributes:
        frames: All frames of the drive.
        world_from_ego: (T, 4, 4) pose of each of them, or None.
        ground_z_m: Height of the road in ego axes, as the drive says.
        cameras: The calibrated cameras.
        runs: Steps to look at: each run holds neighbouring steps, and the runs are spread evenly over the drive.
        sweep: Gives the points of a step; repeated calls are cheap.
        picture: Gives the picture of a step and a camera, or None where it is missing; repeated calls are cheap.
        skipped: How many frames or pictures the data set left out, by reason.
    """

    frames: tuple[Frame, ...]
    world_from_ego: Array | None
    ground_z_m: float
    cameras: tuple[Camera, ...]
    runs: tuple[tuple[int, ...], ...]
    sweep: Callable[[int], Points]
    picture: Callable[[int, str], Image | None]
    skipped: Mapping[str, int] = field(default_factory=dict)

    @property
    def steps(self) -> tuple[int, ...]:
        """All steps to look at, ascending."""
        return tuple(sorted({step for run in self.runs for step in run}))

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Neighbouring steps whose sweeps can be compared."""
        return tuple(pair for run in self.runs for pair in pairwise(run))

    def seconds(self, first: int, second: int) -> float:
        """Return the time from one step to another."""
        return (self.frames[second].time_ns - self.frames[first].time_ns) * 1e-9


def spread_runs(total: int, runs: int, length: int) -> tuple[tuple[int, ...], ...]:
    """Return runs of neighbouring steps, spread evenly over a drive; they do not overlap.

    Args:
        total: Number of frames of the drive.
        runs: Number of runs, fewer where the drive is short.
        length: Steps of a run, fewer where the drive is short.
    """
    if total <= 0:
        return ()
    length = min(length, total)
    count = max(1, min(runs, total // length))
    starts = np.unique(np.linspace(0, total - length, count).round().astype(int))
    return tuple(tuple(range(start, start + length)) for start in starts)
