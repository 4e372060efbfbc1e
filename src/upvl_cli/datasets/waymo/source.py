"""What the two formats of a segment give alike; `drive` makes points of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from upvl_cli.datasets.waymo.calibration import LaserCalibration
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

_MAX_PIXELS = 1 << 22  # of a range image; the largest has 64 x 2650


LaserImage = tuple[int, int, Array]  # laser, return, range image


class SegmentSource(Protocol):
    """One segment. Frames go by their time stamps, in microseconds."""

    @property
    def where(self) -> str:
        """File, for messages."""

    @property
    def poses(self) -> Mapping[int, Array]:
        """The (4, 4) pose of the car at each frame."""

    @property
    def sweeps(self) -> frozenset[int]:
        """Frames that have range images."""

    @property
    def lasers(self) -> Mapping[int, LaserCalibration]:
        """Lasers by number."""

    @property
    def cameras(self) -> Mapping[int, Camera]:
        """Cameras by number."""

    @property
    def has_projections(self) -> bool:
        """Whether the segment tells the pixels of its points."""

    @property
    def skipped(self) -> Mapping[str, int]:
        """What was left out, by reason."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that can be read, except labels."""

    def range_images(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 4) of each return of a frame, in the order of the file."""

    def pixel_poses(self, timestamp_us: int, laser: int) -> Array | None:
        """Return (height, width, 6), or None where it is missing."""

    def projections(self, timestamp_us: int) -> Iterator[LaserImage]:
        """Yield the (height, width, 6) of each return of a frame, in the order of the file."""

    def picture(self, timestamp_us: int, camera: int) -> tuple[bytes, float] | None:
        """Return the JPEG and the time of its pose (s; NaN where unknown), or None where it is missing."""


def check_shape(shape: tuple[int, ...], channels: int, where: str) -> tuple[int, int, int]:
    """Return height, width and channels of a range image; raises `BadInput` for one that cannot be.

    Args:
        shape: As the file gives it.
        channels: Expected number of channels.
        where: File and frame, for messages.
    """
    if len(shape) != 3 or shape[2] != channels or min(shape) < 1 or shape[0] * shape[1] > _MAX_PIXELS:
        raise BadInput(
            f"{where} is a range image of shape {shape}, expected (height, width, {channels}); copy the file again"
        )
    return shape[0], shape[1], shape[2]
