"""What every source of a recording gives, whatever its files are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from upvl_cli.datasets.shared.point_files.scan import ScanPoints
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera


@dataclass(frozen=True, eq=False)
class LidarScan:
    """What one LiDAR measured for one sweep.

    Attributes:
        lidar: Number of the LiDAR.
        time_ns: Its own time.
        points: The points, in the axes of that LiDAR.
        ego_from_lidar: (4, 4) pose of the LiDAR on the car.
    """

    lidar: int
    time_ns: int
    points: ScanPoints
    ego_from_lidar: Array


@dataclass(frozen=True, eq=False)
class RecordedSweep:
    """One sweep of a recording.

    Attributes:
        item: Its place among all sweeps of the recording, those that are left out included.
        frame: Number of its frame.
        time_ns: Its time.
        world_from_ego: (4, 4) pose at that time, or None where the recording has none.
        scans: What each LiDAR measured.
    """

    item: int
    frame: int
    time_ns: int
    world_from_ego: Array | None
    scans: tuple[LidarScan, ...]


@dataclass(frozen=True)
class LeftOut:
    """A sweep that is left out.

    Attributes:
        item: Its place among all sweeps of the recording.
        reason: Why, without names and numbers: sweeps are counted by it.
        error: The message about this one, or None.
    """

    item: int
    reason: str
    error: BadInput | None = None


@dataclass(frozen=True)
class RecordedPicture:
    """One picture: JPEG or PNG, taken by a camera for a sweep."""

    frame: int
    camera: str
    time_ns: int
    data: bytes


class Recording(Protocol):
    """One drive as its owner recorded it; opened lazily, streamed in order."""

    @property
    def name(self) -> str:
        """A name for its segment, from the name of its file or folder."""

    @property
    def total(self) -> int:
        """How many sweeps there are, those that are left out included."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that is read: a change of one makes the drive another."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was recognised, and what was taken from where: a line each, for people."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The calibrated cameras."""

    def sample(self) -> Sequence[LidarScan]:
        """Return a few scans from which units and scales are read."""

    def sweeps(self, first: int) -> Iterator[RecordedSweep | LeftOut]:
        """Yield the sweeps in order, from item number `first` on."""

    def pictures(self, times_ns: Mapping[int, int]) -> Iterator[RecordedPicture | LeftOut]:
        """Yield the picture of each camera that is nearest to each sweep.

        Args:
            times_ns: Time of each frame that was kept.
        """
