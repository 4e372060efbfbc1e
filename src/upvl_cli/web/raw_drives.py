"""Sweeps and pictures of the raw drives, the last ones kept; a drive whose files are gone has none."""

from __future__ import annotations

import threading
import time

from upvl_cli.errors import UpvlError, one_line
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.bounded_cache import BoundedCache
from upvl_cli.types import Array, Camera, Drive

_OPEN_DRIVES = 4
_SWEEP_BYTES = 2**26
_PICTURE_BYTES = 2**27
_TRY_AGAIN_S = 30.0  # after a drive could not be opened


class NoRawData(UpvlError):
    """The sweep or the picture is not there."""


class RawDrives:
    """Opens drives and reads their frames for several threads."""

    def __init__(self, workspace: Workspace) -> None:
        """Name the workspace; nothing is opened yet."""
        self._workspace = workspace
        self._drives: BoundedCache[Drive] = BoundedCache(_OPEN_DRIVES)
        self._sweeps: BoundedCache[Array] = BoundedCache(_SWEEP_BYTES, lambda sweep: sweep.nbytes)
        self._pictures: BoundedCache[Array] = BoundedCache(_PICTURE_BYTES, lambda rgb: rgb.nbytes)
        self._failed: dict[str, tuple[float, str]] = {}
        self._lock = threading.Lock()

    def drive(self, segment: str) -> Drive:
        """Return an open drive.

        Raises:
            NoRawData: It cannot be read.
        """
        with self._lock:
            opened = self._drives.get(segment)
            if opened is not None:
                return opened
            failed_s, problem = self._failed.get(segment, (-_TRY_AGAIN_S, ""))
            if time.monotonic() - failed_s < _TRY_AGAIN_S:
                raise NoRawData(problem)
            try:
                drive = self._workspace.drive(segment)
            except (UpvlError, OSError, ImportError) as error:
                problem = f"the raw drive cannot be read: {one_line(error)}"
                self._failed[segment] = time.monotonic(), problem
                raise NoRawData(problem) from None
            self._drives.put(segment, drive)
            return drive

    def cameras(self, segment: str) -> tuple[Camera, ...]:
        """Return the cameras of a drive; none where it cannot be read."""
        try:
            return self.drive(segment).cameras
        except NoRawData:
            return ()

    def points(self, segment: str, frame: int) -> Array:
        """Return (n, 3) points of a sweep in ego axes.

        Raises:
            NoRawData: It cannot be read.
        """
        return self._sweeps.get_or_make((segment, frame), lambda: self._read_points(segment, frame))

    def _read_points(self, segment: str, frame: int) -> Array:
        drive = self.drive(segment)
        try:
            return drive.points(frame).xyz_ego_m
        except (UpvlError, OSError, KeyError, IndexError) as error:
            raise NoRawData(f"the sweep of frame {frame} cannot be read: {one_line(error)}") from None

    def picture(self, segment: str, frame: int, camera: str) -> Array:
        """Return the (height, width, 3) picture of a camera.

        Raises:
            NoRawData: There is none, or it cannot be read.
        """
        key = segment, frame, camera
        return self._pictures.get_or_make(key, lambda: self._read_picture(segment, frame, camera))

    def _read_picture(self, segment: str, frame: int, camera: str) -> Array:
        drive = self.drive(segment)
        try:
            image = drive.image(frame, camera)
        except (UpvlError, OSError, KeyError, IndexError) as error:
            raise NoRawData(
                f"the picture {camera} of frame {frame} cannot be read: {one_line(error)}"
            ) from None
        if image is None:
            raise NoRawData(f"camera {camera} has no picture of frame {frame}")
        return image.rgb
