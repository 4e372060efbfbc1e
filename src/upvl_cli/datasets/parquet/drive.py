"""One drive of the open door."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from upvl_cli.datasets.parquet.cameras import PictureTable, open_pictures, read_cameras
from upvl_cli.datasets.parquet.points import PointTable, open_points
from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.point_files.scan import NO_RETURN
from upvl_cli.geometry.motion_compensation import compensate
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.types import Array, Camera, Frame, Image, Points


@dataclass(frozen=True, eq=False)
class ParquetDrive:
    """A drive as `points`, `cameras` and `images` tables.

    It has all that a `Drive` has, and also:

    Attributes:
        table: The sweeps.
        pictures: The pictures; None without cameras.
        skipped_points: How many points were left out of each sweep that was read, by frame and reason.
    """

    name: str
    table: PointTable
    cameras: tuple[Camera, ...]
    pictures: PictureTable | None
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    skipped_points: dict[int, Mapping[str, int]] = field(default_factory=dict)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames, one a row of the points table."""
        return self.table.frames

    @property
    def world_from_ego(self) -> Array | None:
        """(T, 4, 4) poses, or None."""
        return self.table.world_from_ego

    @cached_property
    def ground_z_m(self) -> float:
        """Height of the road below the car, measured in the first sweep."""
        return road_height_m(self.points(self.frames[0].index).xyz_ego_m)

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame, motion-compensated where that is not done and the drive has poses.

        Raises:
            BadInput: There is no such frame, or its row is damaged.
        """
        step, points = self._read(frame)
        if self.table.is_compensated or self.world_from_ego is None or not points.time_offset_ns.any():
            return points
        near = slice(max(step - 1, 0), step + 2)
        times_ns = [known.time_ns for known in self.frames[near]]
        moved = compensate(
            points.xyz_ego_m, points.time_offset_ns, step - near.start, times_ns, self.world_from_ego[near]
        )
        return replace(points, xyz_ego_m=moved)

    def measured_points(self, frame: int) -> Points | None:
        """Return the sweep of a frame with each point where it was measured; None where the file does not hold that.

        Raises:
            BadInput: There is no such frame, or its row is damaged.
        """
        return None if self.table.is_compensated else self._read(frame)[1]

    def _read(self, frame: int) -> tuple[int, Points]:
        """Return the number of a frame in the drive, and its sweep as the file has it."""
        step = of_frame(self.name, self._steps, frame)
        points, without_place = self.table.read(step)
        self.skipped_points[frame] = {NO_RETURN: without_place}
        return step, points

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera, or None where it is missing.

        Raises:
            BadInput: There is no such camera, or the picture is damaged.
        """
        found = camera_of_name(self.name, self.cameras, camera)
        return None if self.pictures is None else self.pictures.read(frame, found)

    @cached_property
    def _steps(self) -> dict[int, int]:
        return {frame.index: step for step, frame in enumerate(self.frames)}


def open_drive(root: Path, segment: str) -> ParquetDrive:
    """Return a drive; neither sweeps nor pictures are read yet.

    Args:
        root: The folder with the folders of tables.
        segment: Name of the drive, which is that of its files.

    Raises:
        BadInput: A table is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    point_path, camera_path, picture_path = (
        root / folder / f"{segment}.parquet" for folder in ("points", "cameras", "images")
    )
    table = open_points(point_path)
    files = [point_path]
    cameras: tuple[Camera, ...] = ()
    pictures = None
    if picture_path.is_file():
        files.append(picture_path)
        if camera_path.is_file():
            files.append(camera_path)
            cameras = read_cameras(camera_path)
        numbers = [frame.index for frame in table.frames]
        pictures = open_pictures(root, picture_path, numbers, [camera.name for camera in cameras], skipped)
        taken = Counter(name for _, name in pictures.row)
        cameras = tuple(camera for camera in cameras if taken[camera.name])
        for camera in cameras:
            pictures.check_size(camera)
            if taken[camera.name] < len(numbers):
                skipped[f"no {camera.name} picture"] += len(numbers) - taken[camera.name]
        files += pictures.files
    return ParquetDrive(segment, table, cameras, pictures, dict(skipped), tuple(files))
