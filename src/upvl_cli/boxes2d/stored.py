"""Boxes as a file holds them, of many drives."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.types import Array, ParallelArrays, array


@dataclass(frozen=True)
class StoredBoxes(ParallelArrays):
    """Boxes in pictures of drives.

    Attributes:
        segment: (n,) name of the drive.
        frame: (n,) number of the frame in it.
        camera: (n,) name of the camera.
        edges_px: (n, 4) left, top, right and bottom edge, from the upper left corner of the picture.
        score: (n,) confidence.
        name: (n,) name of the kind.
    """

    segment: Array = array("str")
    frame: Array = array("int64")
    camera: Array = array("str")
    edges_px: Array = array("float64", 4)
    score: Array = array("float64")
    name: Array = array("str")
