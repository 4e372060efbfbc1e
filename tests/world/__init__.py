"""The tests' world: a few frames of the built-in street, computed once, with what is true of them."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TypeVar

from upvl_cli.types import Labels, ParallelArrays, Points
from world.labels import StreetLabels
from world.street import PointTruth, StreetDrive, Streets

FRAMES = 6
SEGMENT = "street-0"
T = TypeVar("T", bound=ParallelArrays)


@cache
def drive() -> StreetDrive:
    """A drive of `FRAMES` frames."""
    return Streets(frames=FRAMES).open(SEGMENT)


@cache
def sweep(frame: int) -> tuple[Points, PointTruth]:
    """The points of a frame and what is true of them, read-only."""
    points, truth = drive().points_with_truth(frame)
    return _locked(points), _locked(truth)


@cache
def labels() -> Labels:
    """The exact boxes of all frames, read-only."""
    return _locked(StreetLabels(frames=FRAMES).labels(SEGMENT))


def _locked(things: T) -> T:
    for spec in fields(things):
        getattr(things, spec.name).flags.writeable = False
    return things
