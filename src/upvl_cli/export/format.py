"""What a format is: how boxes are written and read back, and what it can carry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses

# What boxes have beside their place, size, heading and class.
SCORE, VELOCITY, TRACK, POINTS = "scores", "velocities", "track ids", "point counts"
ALL = frozenset({SCORE, VELOCITY, TRACK, POINTS})


@dataclass(frozen=True)
class ExportOptions:
    """Choices of one export.

    Attributes:
        camera: Name of the camera whose axes and picture a format with one camera takes; empty for the one that
            looks most nearly forward.
        with_data: Whether points and pictures are written too, where the format has a place for them.
        names: "class" or "word": which column of the labels names the boxes.
        digests: Digest of the labels of each drive, by which a later import sees that they are still the same.
        world_axes: Whether formats of points write them in the axes of the world instead of those of the car.
    """

    camera: str = ""
    with_data: bool = False
    names: str = "class"
    digests: Mapping[str, str] = field(default_factory=dict)
    world_axes: bool = False


class WriteLabels(Protocol):
    """Writes drives into a new folder."""

    def __call__(
        self, drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses
    ) -> None:
        """Write the drives; `losses` counts what the format cannot carry."""


class ReadLabels(Protocol):
    """Reads boxes of known drives."""

    def __call__(self, folder: Path, drives: Mapping[str, ExportDrive]) -> Mapping[str, ExportBoxes]:
        """Return the boxes by drive, with classes in the words of the format; raises `BadInput`.

        Args:
            folder: What `write` made, or a tool.
            drives: Frames, poses and cameras of the drives that are known, by name; their boxes do not count.
        """


@dataclass(frozen=True)
class ExportFormat:
    """One format.

    Attributes:
        name: Name on the command line.
        write: Writes drives.
        read: Reads them back; None where boxes in three dimensions cannot come back.
        carries: What of `ALL` comes back.
        classes: Class of the format by class of upvl; any other class keeps its own name.
        fixed_classes: Whether tools of this format know the classes in `classes` alone.
        tool_step: What its tools round places and sizes (m) and headings (rad) to, where that is more than the
            import takes for untouched anyway; 0 for nothing.
    """

    name: str
    write: WriteLabels
    read: ReadLabels | None
    carries: frozenset[str] = ALL
    classes: Mapping[str, str] = field(default_factory=dict)
    fixed_classes: bool = False
    tool_step: float = 0.0
