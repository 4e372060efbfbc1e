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

# Of each class of the labels; at least 3:1 against white and against BACKGROUND, so that plots use them as well.
CLASSES: dict[str, Colour] = {
    "vehicle": (59, 130, 246),
    "pedestrian": (229, 72, 77),
    "cyclist": (217, 119, 6),
    "other": (151, 96, 235),
    "unknown": (124, 133, 148),
}

# What became of a box between two runs.
CHANGES: dict[str, Colour] = {
    "kept": (124, 133, 148),
    "moved": (245, 180, 60),
    "new": (64, 200, 120),
    "lost": (240, 82, 90),
}

_HUE_STEP = 0.61803398875  # golden ratio: the hues of successive ids lie far apart


def track_colour(track_id: int) -> Colour:
    """Return the bright colour that a track has in every picture."""
    red, green, blue = colorsys.hsv_to_rgb((track_id * _HUE_STEP) % 1.0, 0.62, 1.0)
    return round(red * 255), round(green * 255), round(blue * 255)


# What people expect of the usual classes: plants are green, the ground is dull, and road users are bright.
_USUAL: dict[str, Colour] = {
    "road": (112, 92, 128),
    "street": (112, 92, 128),
    "sidewalk": (206, 122, 190),
    "building": (152, 112, 92),
    "house": (176, 132, 100),
    "wall": (126, 126, 150),
    "fence": (196, 168, 140),
    "pole": (206, 206, 206),
    "traffic light": (250, 180, 40),
    "traffic sign": (236, 232, 70),
    "vegetation": (74, 148, 66),
    "tree": (74, 148, 66),
    "terrain": (158, 206, 120),
    "grass": (158, 206, 120),
    "person": (235, 56, 78),
    "pedestrian": (235, 56, 78),
    "cyclist": (255, 120, 160),
    "car": (70, 118, 240),
    "truck": (64, 206, 216),
    "bus": (30, 150, 172),
    "tram": (150, 226, 236),
}
# Saturation and value of all others: with twenty of them hues alone lie too close.
_TONES = ((0.62, 1.0), (0.95, 0.75), (0.3, 0.95))


def class_colour(number: int, name: str) -> Colour:
    """Return the colour of a class or word, by its name where that is usual, else by its place in the list."""
    if name in _USUAL:
        return _USUAL[name]
    saturation, value = _TONES[number % len(_TONES)]
    red, green, blue = colorsys.hsv_to_rgb((number * _HUE_STEP) % 1.0, saturation, value)
    return round(red * 255), round(green * 255), round(blue * 255)
