"""Boxes drawn on a camera's picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import BoxPaint
from upvl_cli.geometry.boxes import corners
from upvl_cli.geometry.camera import project
from upvl_cli.types import Array, Camera, TrackedBoxes

# Corners 0-3 are the bottom and 4-7 the top, both counter-clockwise from the front left.
EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
FRONT = (0, 3, 7, 4)
MIN_DEPTH_M = 0.5  # an edge that comes closer to the lens would cross the whole picture
PIECES = 8  # a lens bends an edge: it is drawn in pieces
FAR_PX = 10_000  # a point this far outside is left out, for Pillow draws lines pixel by pixel, visible or not
MIN_WIDTH_PX = 1200  # smaller pictures are enlarged, so that lines and ids can be read


def camera_view(
    rgb: Array,
    camera: Camera,
    boxes: TrackedBoxes,
    paints: Sequence[BoxPaint] | None = None,
    width_px: int | None = None,
) -> Image.Image:
    """Draw the boxes of one frame on a picture.

    Args:
        rgb: (height, width, 3) uint8 picture.
        camera: The camera of the picture.
        boxes: The boxes, in the ego axes of the frame.
        paints: Of each box its colour and text; None takes the colour and the id of its track.
        width_px: Width of the picture; None enlarges small ones by a round factor.
    """
    image = Image.fromarray(rgb)
    scale: float = max(1, -(-MIN_WIDTH_PX // image.width)) if width_px is None else width_px / image.width
    size = round(image.width * scale), round(image.height * scale)
    image = image.resize(size, Image.Resampling.BICUBIC, reducing_gap=3.0)
    if paints is None:
        paints = [
            BoxPaint(colours.track_colour(track_id), str(track_id)) for track_id in boxes.track_id.tolist()
        ]
    draw = ImageDraw.Draw(image)
    far_first = np.argsort(-np.linalg.norm(boxes.center_m[:, :2], axis=1))
    uv_px, is_drawn, _ = edge_pieces(camera, corners(boxes[far_first]))
    for place, box in enumerate(far_first.tolist()):
        _box(draw, (uv_px[place] + 0.5) * scale, is_drawn[place], paints[box])
    return image


def edge_pieces(camera: Camera, corners_m: Array) -> tuple[Array, Array, Array]:
    """Return (n, 12, k, 2) pixels of the pieces of all edges, and (n, 12, k) which can be drawn and which are in view.

    Args:
        camera: The camera of the picture.
        corners_m: (n, 8, 3) corners of the boxes, in ego axes.
    """
    share = np.linspace(0.0, 1.0, PIECES)[:, None]
    start, end = np.array(EDGES).T
    points = corners_m[:, start, None] * (1 - share) + corners_m[:, end, None] * share  # (n, 12, k, 3)
    uv_px, depth_m, in_view = project(camera, points.reshape(-1, 3))
    is_drawn = (depth_m > MIN_DEPTH_M) & (np.abs(uv_px) < FAR_PX).all(axis=1)  # and finite
    shape = points.shape[:3]
    return uv_px.reshape(*shape, 2), is_drawn.reshape(shape), in_view.reshape(shape)


def _box(draw: ImageDraw.ImageDraw, pixels: Array, is_drawn: Array, paint: BoxPaint) -> None:
    """Draw the edges of one box, given (12, k, 2) pixels of their pieces and which of them can be drawn."""
    anchors = []
    for edge, (start, end) in enumerate(EDGES):
        if is_drawn[edge].sum() < 2:
            continue
        line = [(float(column), float(row)) for column, row in pixels[edge][is_drawn[edge]]]
        draw.line(line, fill=paint.colour, width=3 if {start, end} <= set(FRONT) else 1)
        anchors.append(line[0])
    if anchors:
        place = min(anchors, key=lambda pixel: pixel[1])
        draw.text(place, paint.text, fill=paint.colour, font=ImageFont.load_default(13))
