"""One segment of Waymo's, in either format: its frames, points and pictures.

Ego axes are those of Waymo's vehicle: the origin is on the road below the middle of the rear axle.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np

from upvl_cli.datasets.shared.lookup import camera_of_name, of_frame
from upvl_cli.datasets.shared.pictures import read_picture
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.datasets.waymo.names import CAMERAS
from upvl_cli.datasets.waymo.range_images import LaserReturn, laser_return, pixels_with_return
from upvl_cli.datasets.waymo.source import LaserImage, SegmentSource
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Floats, Frame, Image, Ints, Points

_CACHED_FRAMES = 3  # two threads read a frame's points and its pictures
_MAX_PICTURE_DELAY_S = 10.0  # after the frame's time; real ones are taken within a tenth of a second

_NO_PIXELS = np.zeros(0, np.int64)

T = TypeVar("T")


class WaymoDrive:
    """One segment. Where it has sweeps its frames are those with one; else all frames, of which none has points.

    It has all that a `Drive` has, also the pixels of its points, and:

    Attributes:
        source: The segment in its format.
        timestamps_us: Waymo's time stamp of each frame by its index.
    """

    ground_z_m = 0.0

    def __init__(self, name: str, source: SegmentSource) -> None:
        """Choose the frames.

        Args:
            name: Name of the segment.
            source: The segment in its format.

        Raises:
            BadInput: It has no frame, or times that do not ascend.
        """
        self.name, self.source = name, source
        times_us = sorted(source.poses)
        kept = [stamp for stamp in times_us if stamp in source.sweeps] or times_us
        if not kept:
            raise BadInput(f"{source.where} has no frame of the segment {name}; copy the file again")
        number = {stamp: index for index, stamp in enumerate(times_us)}
        self.timestamps_us = {number[stamp]: stamp for stamp in kept}
        frames = [Frame(index, stamp * 1000) for index, stamp in self.timestamps_us.items()]
        self.frames = check_frames(frames, source.where)
        self.world_from_ego: Array | None = np.array([source.poses[stamp] for stamp in kept])
        skipped = Counter(source.skipped)
        if source.sweeps:
            skipped["no LiDAR sweep"] += len(times_us) - len(kept)
            skipped["LiDAR sweep without a pose"] += len(source.sweeps.difference(times_us))
        self.skipped: Mapping[str, int] = {reason: count for reason, count in skipped.items() if count}
        self.cameras: tuple[Camera, ...] = tuple(source.cameras[camera] for camera in sorted(source.cameras))
        self.files: tuple[Path, ...] = source.files
        self._pixels: OrderedDict[int, dict[tuple[int, int], Ints]] = OrderedDict()
        self._projections: OrderedDict[int, Array] = OrderedDict()
        self._lock = threading.Lock()

    def _timestamp_us(self, frame: int) -> int:
        return of_frame(self.name, self.timestamps_us, frame)

    def _images(self, frame: int) -> Iterator[LaserImage]:
        """Return the range images of a frame, of calibrated lasers."""
        stamp = self._timestamp_us(frame)
        if stamp not in self.source.sweeps:
            raise BadInput(
                f"{self.source.where}: segment {self.name} has no LiDAR sweep (its range images are missing or "
                "empty), only poses, pictures or labels; get the component lidar, or the whole record"
            )
        return (image for image in self.source.range_images(stamp) if image[0] in self.source.lasers)

    def returns(self, frame: int) -> list[LaserReturn]:
        """Return the points of a frame by laser and return, in double precision and with all that Waymo gives.

        Args:
            frame: Index of the frame.

        Raises:
            BadInput: There is no such frame, or its files are damaged.
        """
        stamp = self._timestamp_us(frame)
        pose = self.source.poses[stamp]
        where = f"{self.source.where}, frame {stamp}"
        pixel_poses: dict[int, Array | None] = {}
        found = []
        for laser, number, image in self._images(frame):
            if laser not in pixel_poses:
                pixel_poses[laser] = self.source.pixel_poses(stamp, laser)
            calibration = self.source.lasers[laser]
            found.append(laser_return(laser, number, image, calibration, pixel_poses[laser], pose, where))
        found.sort(key=lambda item: (item.laser, item.return_number))
        self._keep_recent(
            self._pixels, frame, {(item.laser, item.return_number): item.pixel for item in found}
        )
        return found

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame: lasers 1 to 5, of each the first returns and then the second.

        Intensities, which have no upper bound, are compressed to 0 to 1 by tanh.

        Raises:
            BadInput: There is no such frame, or its files are damaged.
        """
        found = self.returns(frame)
        count, places_m = [len(item.pixel) for item in found], [item.xyz_ego_m for item in found]
        intensity = np.concatenate([*(item.intensity for item in found), np.zeros(0, np.float32)])
        return Points(
            xyz_ego_m=np.concatenate([*places_m, np.zeros((0, 3))], dtype=np.float32, casting="same_kind"),
            intensity=np.tanh(np.maximum(intensity, 0)),
            elongation=np.concatenate([*(item.elongation for item in found), np.zeros(0, np.float32)]),
            sensor=np.repeat(np.array([item.laser for item in found], np.uint8), count),
            time_offset_ns=np.zeros(sum(count), np.int64),
        )

    def projections(self, frame: int) -> Array:
        """Return (n, 6) camera, x, y of the first and of the second camera that see each point of a frame.

        Cameras by Waymo's numbers, 0 for none; columns and rows of its pictures.

        Raises:
            BadInput: There is no such frame, or its files are damaged.
        """
        return self._cached(self._projections, frame, self._read_projections)

    def _read_projections(self, frame: int) -> Array:
        pixels = self._cached(self._pixels, frame, self._read_pixels)
        count = [len(pixel) for pixel in pixels.values()]
        first = dict(zip(pixels, np.cumsum([0, *count]).tolist(), strict=False))
        found = np.zeros((sum(count), 6), np.float32, order="F")  # cameras are looked for by column
        for laser, number, image in self.source.projections(self._timestamp_us(frame)):
            pixel = pixels.get((laser, number), _NO_PIXELS)
            if not len(pixel):
                continue
            if pixel[-1] >= image.shape[0] * image.shape[1]:
                raise BadInput(
                    f"{self.source.where}, frame {self._timestamp_us(frame)}: laser {laser}, return {number} has a "
                    f"camera projection of {image.shape[:2]} pixels, smaller than its range image; copy it again"
                )
            start = first[laser, number]
            found[start : start + len(pixel)] = image.reshape(-1, 6).take(pixel, axis=0)
        return found

    def _read_pixels(self, frame: int) -> dict[tuple[int, int], Ints]:
        found = {(laser, number): pixels_with_return(image) for laser, number, image in self._images(frame)}
        return dict(sorted(found.items()))

    def _cached(self, cache: OrderedDict[int, T], frame: int, read: Callable[[int], T]) -> T:
        with self._lock:
            if frame in cache:
                return cache[frame]
        found = read(frame)
        self._keep_recent(cache, frame, found)
        return found

    def _keep_recent(self, cache: OrderedDict[int, T], frame: int, found: T) -> None:
        with self._lock:
            cache[frame] = found
            while len(cache) > _CACHED_FRAMES:
                cache.popitem(last=False)

    def pixels(self, frame: int, camera: str) -> Floats | None:
        """Return (n, 2) pixels of the points of a frame as Waymo gives them, rolling shutter included.

        Args:
            frame: Index of the frame.
            camera: Name of the camera.

        Returns:
            NaN where that camera is not one of the two that Waymo names; None where the segment has no projections.

        Raises:
            BadInput: There is no such frame or camera, or the files are damaged.
        """
        number = self._camera_number(camera)
        self._timestamp_us(frame)
        if not self.source.has_projections:
            return None
        projections, size = self.projections(frame), self.source.cameras[number]
        pixels = np.full((len(projections), 2), np.nan)
        for first in (3, 0):
            seen = np.flatnonzero(projections[:, first] == number)
            x, y = projections[seen, first + 1], projections[seen, first + 2]
            inside = (x >= 0) & (x < size.width_px) & (y >= 0) & (y < size.height_px)
            pixels[seen[inside], 0], pixels[seen[inside], 1] = x[inside], y[inside]
        return pixels

    def _camera_number(self, camera: str) -> int:
        found = camera_of_name(self.name, self.cameras, camera)
        return next(number for number, known in self.source.cameras.items() if known is found)

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera, at the time of its pose, or None where it is missing.

        Args:
            frame: Index of the frame.
            camera: Name of the camera.

        Raises:
            BadInput: There is no such frame or camera, or the picture is damaged.
        """
        number, stamp = self._camera_number(camera), self._timestamp_us(frame)
        found = self.source.picture(stamp, number)
        if found is None:
            return None
        content, pose_time_s = found
        where = f"{self.source.where}, frame {stamp}: the picture of camera {CAMERAS[number]}"
        time_ns = stamp * 1000
        if not np.isnan(pose_time_s):
            if not abs(pose_time_s - stamp / 1e6) <= _MAX_PICTURE_DELAY_S:
                raise BadInput(f"{where} was taken at {pose_time_s:.1f} s, the frame at {stamp / 1e6:.1f} s")
            time_ns = round(pose_time_s * 1e9)
        size = self.source.cameras[number]
        return Image(read_picture(content, size.width_px, size.height_px, where), time_ns)
