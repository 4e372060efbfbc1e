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
