"""Points coloured by their nearest word, from above and on a camera's picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import View
from upvl_cli.types import Array, Floats, Ints

NO_WORD = -1
DOT_PX = 2


def words_above(view: View, xyz_ego_m: Array, word: Ints, words: Sequence[str]) -> Image.Image:
    """Draw a sweep from above, each point in the colour of its word.

    Args:
        view: The part of the ground to show.
        xyz_ego_m: (n, 3) points.
        word: (n,) place in `words`, `NO_WORD` for a point without a feature.
        words: The words.
    """
    canvas = np.full((*view.size_px[::-1], 3), colours.BACKGROUND, np.uint8)
    low_first = np.argsort(xyz_ego_m[:, 2], kind="stable")
    _dots(canvas, view.pixels(xyz_ego_m[low_first, :2]), _colour(word[low_first], words), 1)
    return _with_legend(Image.fromarray(canvas), word, words)


def words_in_view(rgb: Array, uv_px: Floats, word: Ints, words: Sequence[str]) -> Image.Image:
    """Draw points on a picture, each in the colour of its word.

    Args:
        rgb: (height, width, 3) uint8 picture.
        uv_px: (n, 2) where the points appear in it.
        word: (n,) place in `words` of each.
        words: The words.
    """
    canvas = np.asarray(rgb) // 2  # darker, so that the colours of the dots are told from its own
    _dots(canvas, uv_px + 0.5, _colour(word, words), DOT_PX)
    return _with_legend(Image.fromarray(canvas), word, words)


def _colour(word: Ints, words: Sequence[str]) -> Array:
    palette = [*(colours.class_colour(place, name) for place, name in enumerate(words)), colours.GROUND]
    return np.array(palette)[word].astype(np.uint8)  # the last entry is that of NO_WORD = -1


def _dots(canvas: Array, pixels: Array, colour: Array, size_px: int) -> None:
    for across in range(size_px):
        for down in range(size_px):
            columns, rows = (pixels + (across, down)).astype(np.int64).T
            inside = (columns >= 0) & (columns < canvas.shape[1]) & (rows >= 0) & (rows < canvas.shape[0])
            canvas[rows[inside], columns[inside]] = colour[inside]


def _with_legend(image: Image.Image, word: Ints, words: Sequence[str]) -> Image.Image:
    """Write the words that a point has; a list of twenty does not fit beside a low picture."""
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(14)
    present = np.unique(word[word != NO_WORD]).tolist()
    for line, place in enumerate(present):
        top = 6 + 18 * line
        draw.rectangle((6, top, 18, top + 12), fill=colours.class_colour(place, words[place]))
        draw.text((24, top - 2), words[place], fill=colours.TEXT, font=font)
    return image
