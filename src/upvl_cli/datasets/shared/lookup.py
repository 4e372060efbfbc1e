"""Frames and cameras of a drive by what a caller names them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

from upvl_cli.errors import BadInput
from upvl_cli.types import Camera

T = TypeVar("T")


def of_frame(drive: str, by_frame: Mapping[int, T], frame: int) -> T:
    """Return what a drive has for a frame.

    Args:
        drive: Name of the drive, for the message.
        by_frame: What it has, by frame index.
        frame: Index of the frame.

    Raises:
        BadInput: There is no such frame.
    """
    if frame not in by_frame:
        raise BadInput(
            f"{drive} has no frame {frame}; it has {len(by_frame)} between {min(by_frame)} and {max(by_frame)}"
        )
    return by_frame[frame]


def camera_of_name(drive: str, cameras: Sequence[Camera], name: str) -> Camera:
    """Return the camera of a drive by its name; raises `BadInput` where it has none of that name."""
    found = next((camera for camera in cameras if camera.name == name), None)
    if found is None:
        known = ", ".join(camera.name for camera in cameras) or "none"
        raise BadInput(f"{drive} has no camera {name!r}; it has {known}")
    return found
