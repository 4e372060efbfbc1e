"""Where a drive's points appear in its pictures, for data sets that give this themselves."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from upvl_cli.types import Floats


@runtime_checkable
class PixelSource(Protocol):
    """A drive that knows the pixels of its points, for example by a model of its rolling shutter."""

    def pixels(self, frame: int, camera: str) -> Floats | None:
        """Return (n, 2) pixels of the points of the sweep of a frame in a camera's picture.

        NaN where the camera does not see the point; None where the camera's calibration has to be used.
        """
