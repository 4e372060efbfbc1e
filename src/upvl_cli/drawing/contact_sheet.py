"""The contact sheet of a synthetic frame: its pictures, the object of each pixel, and the sweep from above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from upvl_cli.drawing import colours
from upvl_cli.types import Array, Ints

STRIP_PX = 1600  # width of the sheet
REACH_M = 45.0  # of the view from above, to each side
LINE_PX = 18
SKY: colours.Colour = (150, 190, 225)


class LabelledPicture(NamedTuple):
    """A picture and the number of the name of each pixel, -1 for the sky."""

    rgb: Array
    name: Ints


def contact_sheet(
    shots: Sequence[LabelledPicture], xyz_ego_m: Array, name: Ints, names: Sequence[str], title: str
) -> Image.Image:
    """Draw the sheet: a strip of pictures, the same by name, and below them the sweep and the names.

    Args:
        shots: What the cameras see, from left to right.
        xyz_ego_m: (n, 3) points of the sweep.
        name: (n,) the number of each point's name.
        names: All names.
        title: Text above.
    """
    palette = np.array([*(colours.track_colour(number) for number in range(len(names))), SKY], dtype=np.uint8)
    strips = [_strip([shot.rgb for shot in shots]), _strip([palette[shot.name] for shot in shots])]
    above = _above(xyz_ego_m, palette[name])
    top = LINE_PX + 8
    height = top + sum(strip.height for strip in strips) + above.height
    sheet = Image.new("RGB", (STRIP_PX, height), colours.BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    draw.text((8, 5), title, fill=colours.TEXT, font=ImageFont.load_default(14))
    for strip in strips:
        sheet.paste(strip, (0, top))
        top += strip.height
    sheet.paste(above, (0, top))
    pixels = np.bincount(np.concatenate([shot.name.ravel() + 1 for shot in shots]), minlength=len(names) + 1)[
        1:
    ]
    points = np.bincount(name, minlength=len(names))
    _legend(draw, (above.width + 20, top + 12), names, palette, pixels, points, height)
    return sheet


def _strip(pictures: Sequence[Array]) -> Image.Image:
    """Return pictures side by side, as wide as the sheet."""
    row = Image.fromarray(np.concatenate(pictures, axis=1))
    return row.resize((STRIP_PX, round(row.height * STRIP_PX / row.width)), Image.Resampling.LANCZOS)


def _above(xyz_ego_m: Array, colour: Array) -> Image.Image:
    size = STRIP_PX // 2
    scale = size / (2 * REACH_M)
    column = np.floor((REACH_M - xyz_ego_m[:, 1]) * scale).astype(np.int64)
    row = np.floor((REACH_M - xyz_ego_m[:, 0]) * scale).astype(np.int64)
    inside = np.flatnonzero((column >= 0) & (column < size) & (row >= 0) & (row < size))
    inside = inside[np.argsort(xyz_ego_m[inside, 2], kind="stable")]  # what is higher covers what is lower
    canvas = np.full((size, size, 3), colours.BACKGROUND, np.uint8)
    canvas[row[inside], column[inside]] = colour[inside]
    return Image.fromarray(canvas)


def _legend(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    names: Sequence[str],
    palette: Array,
    pixels: Ints,
    points: Ints,
    bottom: int,
) -> None:
    """Write the names of the frame with the number of pixels and points of each."""
    left, top = corner
    font = ImageFont.load_default(13)
    x, y = left, top
    for number in np.flatnonzero(pixels + points).tolist():
        colour = tuple(int(value) for value in palette[number])
        draw.rectangle((x, y + 3, x + 11, y + 13), fill=colour)
        draw.text(
            (x + 18, y),
            f"{names[number]}  {pixels[number]:,} px  {points[number]:,} pts",
            fill=colours.TEXT,
            font=font,
        )
        y += LINE_PX
        if y + LINE_PX > bottom:
            x, y = x + 270, top
