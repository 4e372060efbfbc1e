"""Pictures for the viewer: reduced JPEG, and the edges of the boxes as the lens shows them."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image as Pillow

from upvl_cli.drawing.camera_view import edge_pieces
from upvl_cli.geometry.boxes import corners
from upvl_cli.types import Array, Boxes, Camera, Floats

_JPEG_QUALITY = 80


@dataclass(frozen=True)
class BoxEdges:
    """The visible edges of boxes in one picture.

    Attributes:
        strips_px: Of each edge (m, 2) its places, column and row from the upper left corner of the picture.
        box: The box of each edge.
        anchor_px: Of each box that is seen its highest place, by the number of the box.
    """

    strips_px: list[Floats]
    box: list[int]
    anchor_px: dict[int, tuple[float, float]]


def reduction(camera: Camera, picture_px: int | None) -> float:
    """Return the factor by which the pictures of a camera are reduced, at most 1.

    Args:
        camera: The camera.
        picture_px: The most pixels along the longer side; None keeps all.
    """
    longest = max(camera.width_px, camera.height_px)
    return 1.0 if picture_px is None else min(1.0, picture_px / longest)


def size_of(camera: Camera, scale: float) -> tuple[int, int]:
    """Return width and height of a reduced picture."""
    return max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))


def jpeg(rgb: Array, size_px: tuple[int, int]) -> bytes:
    """Return a picture of that width and height as JPEG.

    Args:
        rgb: (height, width, 3) uint8 picture.
        size_px: Width and height.
    """
    image = Pillow.fromarray(rgb)
    if image.size != size_px:
        image = image.resize(size_px, Pillow.Resampling.BILINEAR, reducing_gap=2.0)
    file = io.BytesIO()
    image.save(file, format="JPEG", quality=_JPEG_QUALITY)
    return file.getvalue()


def box_edges(camera: Camera, boxes: Boxes, scale: float) -> BoxEdges:
    """Return the edges of boxes in a picture that is reduced by `scale`.

    A lens bends an edge: it is a line of several pieces. Pieces behind the camera and far outside are left out.

    Args:
        camera: The camera at its full size.
        boxes: The boxes, in ego axes.
        scale: Factor from pixels of the camera to those of the picture.
    """
    edges = BoxEdges([], [], {})
    if not len(boxes):
        return edges
    pixels, is_seen, in_view = edge_pieces(camera, corners(boxes))
    # The camera counts from the centre of its first pixel, the viewer from the corner of the picture.
    strips_px = ((pixels + 0.5) * scale).astype(np.float32)
    for box in np.flatnonzero(in_view.any(axis=(1, 2))).tolist():
        for strip_px, seen in zip(strips_px[box], is_seen[box], strict=True):
            if np.count_nonzero(seen) > 1:
                edges.strips_px.append(strip_px[seen])
                edges.box.append(box)
        top = np.where(is_seen[box], strips_px[box, ..., 1], np.inf)
        if np.isfinite(top).any():
            column, row = strips_px[box].reshape(-1, 2)[top.argmin()].tolist()
            edges.anchor_px[box] = column, row
    return edges
