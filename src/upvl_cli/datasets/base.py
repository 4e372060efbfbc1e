"""What every dataset offers: segments, and inside each of them frames, points, images and poses.

Labels stand apart, in `LabelSource`: no stage that makes labels or trains can reach them, because
a `Drive` does not have them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from upvl_cli.types import Array, Bools, Camera, Frame, Image, Ints, Labels, Points


class Drive(Protocol):
    """One segment, read in place."""

    @property
    def name(self) -> str:
        """Name of the segment; letters, digits, `.`, `_` and `-` only."""

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames that can be read, in ascending order of index and time."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The calibrated cameras; empty where there is none."""

    @property
    def skipped(self) -> Mapping[str, int]:
        """How many frames or images were left out, by reason."""

    @property
    def ground_z_m(self) -> float:
        """Height of the road below the car in ego axes, roughly: a start for the ground search."""

    @property
    def world_from_ego(self) -> Array | None:
        """(T, 4, 4) pose of each of `frames`, or None where the dataset has none."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that can be read: what makes a shard older than its drive."""

    def points(self, frame: int) -> Points:
        """The sweep of the frame of that index."""

    def image(self, frame: int, camera: str) -> Image | None:
        """The picture of that camera, or None where it is missing."""


class Dataset(Protocol):
    """A folder of drives, or a maker of them."""

    @property
    def version(self) -> int:
        """Raised by hand when the adapter gives other points for equal files: part of every stamp."""

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all segments, sorted."""

    def open(self, segment: str) -> Drive:
        """The drive of that name; raises `BadInput` where it cannot be read."""


class LabelSource(Protocol):
    """Human boxes of the same segments; only `upvl eval` opens them."""

    def labels(self, segment: str) -> Labels:
        """All boxes of a segment; raises `BadInput` where it has none."""

    def frames(self, segment: str) -> Ints:
        """(n,) indices of the labelled frames; in the others a box is neither right nor wrong.

        Raises `BadInput` where the drive has no labels.
        """

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """(n,) whether each place lies where objects were labelled, for example in the front view."""
