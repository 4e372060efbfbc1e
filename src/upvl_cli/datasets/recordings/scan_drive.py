"""A recording that lies in files, one a sweep and one a picture, once it is known what belongs to what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.recordings.recording import LeftOut, LidarScan, RecordedPicture, RecordedSweep
from upvl_cli.datasets.shared.content import read_bytes
from upvl_cli.datasets.shared.pictures import read_picture
from upvl_cli.datasets.shared.point_files.read import read_points
from upvl_cli.errors import BadInput
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Array, Camera

DAMAGED = "damaged files of points"
DAMAGED_PICTURE = "damaged pictures, or of another size than their calibration"
NO_PICTURE = "pictures missing for a sweep"
_SAMPLE = 8


@dataclass(frozen=True, eq=False)
class ScanFile:
    """One file of points.

    Attributes:
        path: The file.
        frame: Number of its frame.
        time_ns: Its time.
        world_from_ego: (4, 4) pose, or None.
        reason: Why it is left out; empty where it is read.
    """

    path: Path
    frame: int
    time_ns: int
    world_from_ego: Array | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class PictureFile:
    """One file of a picture, and when it was taken."""

    path: Path
    time_ns: int


@dataclass(frozen=True, eq=False)
class ScanDrive:
    """A recording in files; see `Recording`.

    Attributes:
        name: Name of the segment.
        scans: All files of points, in order.
        ego_from_lidar: (4, 4) turn of the points into ego axes.
        cameras: The calibrated cameras.
        picture_files: The pictures of each camera, by frame.
        more_files: Files of poses, times and calibration.
        notes: What was recognised.
    """

    name: str
    scans: tuple[ScanFile, ...]
    ego_from_lidar: Array
    cameras: tuple[Camera, ...]
    picture_files: Mapping[str, Mapping[int, PictureFile]]
    more_files: tuple[Path, ...]
    notes: tuple[str, ...]

    @property
    def total(self) -> int:
        """How many files of points there are."""
        return len(self.scans)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that is read."""
        pictures = (known.path for files in self.picture_files.values() for known in files.values())
        return (*(scan.path for scan in self.scans), *pictures, *self.more_files)

    def sample(self) -> Sequence[LidarScan]:
        """Return some sweeps from all over the drive; raises `BadInput` where no file can be read."""
        kept = [scan for scan in self.scans if not scan.reason]
        chosen = [kept[place] for place in np.unique(np.linspace(0, len(kept) - 1, _SAMPLE).astype(int))]
        found, errors = [], []
        for scan in chosen:
            try:
                found.append(self._scan(scan))
            except BadInput as error:
                errors.append(error)
        if not found:
            raise errors[0]
        return found

    def sweeps(self, first: int) -> Iterator[RecordedSweep | LeftOut]:
        """Yield the sweeps in order, read by as many threads as there are cores."""
        yield from in_order(self._sweep, range(first, len(self.scans)))

    def _sweep(self, item: int) -> RecordedSweep | LeftOut:
        scan = self.scans[item]
        if scan.reason:
            return LeftOut(item, scan.reason)
        try:
            return RecordedSweep(item, scan.frame, scan.time_ns, scan.world_from_ego, (self._scan(scan),))
        except BadInput as error:
            return LeftOut(item, DAMAGED, error)

    def _scan(self, scan: ScanFile) -> LidarScan:
        return LidarScan(0, scan.time_ns, read_points(scan.path), self.ego_from_lidar)

    def pictures(self, times_ns: Mapping[int, int]) -> Iterator[RecordedPicture | LeftOut]:
        """Yield the picture of each camera for each frame."""
        for item, (frame, camera) in enumerate(
            (frame, camera) for frame in times_ns for camera in self.cameras
        ):
            picture = self.picture_files.get(camera.name, {}).get(frame)
            if picture is None:
                yield LeftOut(item, NO_PICTURE)
                continue
            try:
                content = read_bytes(picture.path)
                # Decoded once: a damaged one is left out here, and stops no stage later.
                read_picture(content, camera.width_px, camera.height_px, picture.path)
                yield RecordedPicture(frame, camera.name, picture.time_ns, content)
            except BadInput as error:
                yield LeftOut(item, DAMAGED_PICTURE, error)
