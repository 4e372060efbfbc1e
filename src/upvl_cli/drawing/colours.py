"""The colours that all pictures share."""

from __future__ import annotations

import colorsys

Colour = tuple[int, int, int]

BACKGROUND: Colour = (18, 20, 24)
GRID: Colour = (44, 48, 56)
TEXT: Colour = (225, 228, 232)
GROUND: Colour = (62, 68, 78)
STATIC: Colour = (150, 158, 170)
MOVING: Colour = (255, 138, 48)

_HUE_STEP = 0.61803398875  # golden ratio: the hues of successive ids lie far apart


def track_colour(track_id: int) -> Colour:
    """Return the bright colour that a track has in every picture."""
    red, green, blue = colorsys.hsv_to_rgb((track_id * _HUE_STEP) % 1.0, 0.62, 1.0)
    return round(red * 255), round(green * 255), round(blue * 255)


# Saturation and value of classes: with twenty of them hues alone lie too close.
_CLASS_TONES = ((0.62, 1.0), (0.95, 0.75), (0.3, 0.95))


def class_colour(number: int) -> Colour:
    """Return the colour of a class or word by its place in the list; neighbours differ in hue and in tone."""
    saturation, value = _CLASS_TONES[number % len(_CLASS_TONES)]
    red, green, blue = colorsys.hsv_to_rgb((number * _HUE_STEP) % 1.0, saturation, value)
    return round(red * 255), round(green * 255), round(blue * 255)
