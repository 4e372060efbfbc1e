"""What a source of 2D boxes offers, and how one is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from upvl_cli.boxes2d.config import SuppressionConfig
    from upvl_cli.types import Array, Boxes2d, Drive


@dataclass(frozen=True)
class CameraPicture:
    """One picture of a drive.

    Attributes:
        frame: Number of the frame.
        camera: Name of the camera.
        rgb: (height, width, 3) uint8 picture.
    """

    frame: int
    camera: str
    rgb: Array


class BoxSource2d(Protocol):
    """Gives the boxes of pictures: a detector looks at them, a table knows them by frame and camera."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """How many boxes were left out when the source was opened, by reason."""

    def boxes(self, picture: CameraPicture) -> Boxes2d:
        """Return the boxes of a picture, in its pixels; safe to be called by several threads."""


@dataclass(frozen=True)
class BoxSourceFamily:
    """How one family of sources is opened.

    Attributes:
        files: From what follows the colon of `detector` in boxes2d.toml, the files whose content gives the boxes:
            it is part of the stamp of every shard. Loads no network.
        open: Opens it for a drive; from the same text.
        example: A value of `detector`, for messages.
        version: Raised by hand when the code gives other boxes for equal files; part of the stamp as well.
    """

    files: Callable[[str], tuple[Path, ...]]
    open: Callable[[str, Drive, SuppressionConfig], BoxSource2d]
    example: str
    version: int = 1
