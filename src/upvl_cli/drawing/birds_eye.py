"""The scene from above: points by state, boxes with id, heading and speed, and the past path of each track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from upvl_cli.drawing import colours
from upvl_cli.geometry.boxes import corners_bev
from upvl_cli.types import Array, Ints, TrackedBoxes

PIXELS_PER_METRE = 14
GRID_M = 10


@dataclass(frozen=True)
class View:
    """The part of the ground that a picture shows, in ego axes (m), and its scale."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    pixels_per_metre: float = PIXELS_PER_METRE

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        width = (self.y_max_m - self.y_min_m) * self.pixels_per_metre
        return round(width), round((self.x_max_m - self.x_min_m) * self.pixels_per_metre)

    def pixels(self, xy_ego_m: Array) -> Array:
        """Return (n, 2) pixels, column and row, of (n, 2) places in ego axes: x points up, y to the left."""
        columns = (self.y_max_m - xy_ego_m[:, 1]) * self.pixels_per_metre
        rows = (self.x_max_m - xy_ego_m[:, 0]) * self.pixels_per_metre
        return np.stack([columns, rows], axis=1)


@dataclass(frozen=True)
class BoxPaint:
    """Colour of a box, and the text beside it; empty for none."""

    colour: colours.Colour
    text: str


def paints_by_track(boxes: TrackedBoxes) -> list[BoxPaint]:
    """Return for each box the colour of its track, and the id of the track with the speed as text."""
    speed_mps = np.linalg.norm(boxes.velocity_mps[:, :2], axis=1)
    return [
        BoxPaint(colours.track_colour(track_id), f"{track_id}  {speed:.1f} m/s")
        for track_id, speed in zip(boxes.track_id.tolist(), speed_mps.tolist(), strict=True)
    ]


def birds_eye(
    view: View,
    xyz_ego_m: Array,
    state: Ints,
    boxes: TrackedBoxes,
    tails: Mapping[int, Array],
    title: str,
    paints: Sequence[BoxPaint] | None = None,
) -> Image.Image:
    """Draw one frame from above.

    Args:
        view: The part of the ground to show.
        xyz_ego_m: (n, 3) points of the sweep.
        state: (n,) 0 ground, 1 background or too slow for a label, 2 candidate for an object.
        boxes: The boxes of the frame, in its ego axes.
        tails: For each track (m, 2) earlier centres in the ego axes of this frame.
        title: Text of the upper left corner.
        paints: Of each box its colour and text; None takes those of `paints_by_track`.
    """
    paints = paints_by_track(boxes) if paints is None else paints
    canvas = np.full((*view.size_px[::-1], 3), colours.BACKGROUND, np.uint8)
    _grid(canvas, view)
    for number, colour in enumerate((colours.GROUND, colours.STATIC, colours.MOVING)):
        _dots(canvas, view.pixels(xyz_ego_m[state == number, :2]), colour, wide=number == 2)
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    colour_of = {int(track_id): paint.colour for track_id, paint in zip(boxes.track_id, paints, strict=True)}
    for track_id, tail in tails.items():
        colour = colour_of.get(track_id, colours.track_colour(track_id))
        _line(draw, view.pixels(tail), colour, width=2)
    for box, paint in enumerate(paints):
        _box(draw, view, boxes[box : box + 1], paint)
    _ego(draw, view)
    draw.text((8, 6), title, fill=colours.TEXT, font=ImageFont.load_default(16))
    return image


def _grid(canvas: Array, view: View) -> None:
    for x in np.arange(np.ceil(view.x_min_m / GRID_M) * GRID_M, view.x_max_m, GRID_M):
        canvas[int(np.clip((view.x_max_m - x) * view.pixels_per_metre, 0, len(canvas) - 1))] = colours.GRID
    for y in np.arange(np.ceil(view.y_min_m / GRID_M) * GRID_M, view.y_max_m, GRID_M):
        canvas[:, int(np.clip((view.y_max_m - y) * view.pixels_per_metre, 0, canvas.shape[1] - 1))] = (
            colours.GRID
        )


def _dots(canvas: Array, pixels: Array, colour: colours.Colour, *, wide: bool) -> None:
    steps = ((0, 0), (0, 1), (1, 0), (1, 1)) if wide else ((0, 0),)
    for right, down in steps:
        columns, rows = (pixels + (right, down)).astype(np.int64).T
        inside = (columns >= 0) & (columns < canvas.shape[1]) & (rows >= 0) & (rows < canvas.shape[0])
        canvas[rows[inside], columns[inside]] = colour


def _line(draw: ImageDraw.ImageDraw, pixels: Array, colour: colours.Colour, width: int) -> None:
    if len(pixels) > 1:
        draw.line([(float(column), float(row)) for column, row in pixels], fill=colour, width=width)


def _box(draw: ImageDraw.ImageDraw, view: View, box: TrackedBoxes, paint: BoxPaint) -> None:
    outline = view.pixels(corners_bev(box)[0])
    _line(draw, np.concatenate([outline, outline[:1]]), paint.colour, width=2)
    center_m, heading_rad = box.center_m[0, :2], box.heading_rad[0]
    front_m = center_m + box.size_lwh_m[0, 0] / 2 * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    _line(draw, view.pixels(np.stack([center_m, front_m])), paint.colour, width=2)
    corner = outline.max(axis=0)
    place = float(corner[0]) + 3, float(corner[1])
    draw.text(place, paint.text, fill=paint.colour, font=ImageFont.load_default(12))


def _ego(draw: ImageDraw.ImageDraw, view: View) -> None:
    marker = view.pixels(np.array([[1.2, 0.0], [-0.8, 0.8], [-0.8, -0.8]]))
    draw.polygon([(float(column), float(row)) for column, row in marker], fill=colours.TEXT)
