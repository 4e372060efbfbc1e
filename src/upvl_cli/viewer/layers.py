"""The colours of points: each layer gives a point a number, and each number has a name and a colour.

Numbers take two bytes a point where colours take four, and the viewer shows the name of the number under the mouse.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.types import Array, Ints
from upvl_cli.viewer.drive_tables import FramePoints

# First number of each layer: one list of names serves them all.
_FLOW, _HEIGHT, _GROUND, _MOTION, _INTENSITY, _WORD = 1000, 2000, 3000, 4000, 5000, 10_000
_STILL_MPS = 0.5
_SPEEDS_MPS = (0.5, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0)
_SECTORS = 16
_LOWEST_M, _HEIGHT_STEP_M, _HEIGHT_STEPS = -1.0, 0.1, 61
_INTENSITY_STEPS = 64
_GREY: colours.Colour = (110, 116, 128)
_TOWARDS = ("ahead", "ahead left", "left", "behind left", "behind", "behind right", "right", "ahead right")


@dataclass(frozen=True)
class Entry:
    """One number of a layer: its name and its colour."""

    number: int
    name: str
    colour: colours.Colour


def fixed_entries() -> Iterator[Entry]:
    """Yield the numbers of all layers but the words, which are those of the drive."""
    yield from _flow_entries()
    for step in range(_HEIGHT_STEPS):
        height_m = _LOWEST_M + step * _HEIGHT_STEP_M
        yield Entry(_HEIGHT + step, f"{height_m:.1f} m above the ground", _ramp(step / (_HEIGHT_STEPS - 1)))
    yield Entry(_GROUND, "above the ground", colours.STATIC)
    yield Entry(_GROUND + 1, "ground", (122, 92, 58))
    yield Entry(_MOTION, "moving", colours.MOVING)
    yield Entry(_MOTION + 1, "standing object", (70, 150, 240))
    yield Entry(_MOTION + 2, "background", _GREY)
    yield Entry(_MOTION + 3, "unknown", colours.GROUND)
    for step in range(_INTENSITY_STEPS):
        share = step / (_INTENSITY_STEPS - 1)
        yield Entry(_INTENSITY + step, f"intensity {share:.2f}", _ramp(share))


def _flow_entries() -> Iterator[Entry]:
    yield Entry(_FLOW, f"slower than {_STILL_MPS} m/s", _GREY)
    for sector in range(_SECTORS):
        towards = _TOWARDS[round(sector * len(_TOWARDS) / _SECTORS) % len(_TOWARDS)]
        for level, speed_mps in enumerate(_SPEEDS_MPS):
            share = (level + 1) / len(_SPEEDS_MPS)
            red, green, blue = colorsys.hsv_to_rgb(sector / _SECTORS, 0.35 + 0.6 * share, 1.0)
            colour = round(red * 255), round(green * 255), round(blue * 255)
            number = _FLOW + 1 + sector * len(_SPEEDS_MPS) + level
            yield Entry(number, f"{speed_mps} m/s and more, {towards}", colour)


def _ramp(share: float) -> colours.Colour:
    """Return a colour from blue over green to red; `share` from 0 to 1."""
    red, green, blue = colorsys.hsv_to_rgb(0.68 * (1 - share), 0.85, 0.65 + 0.35 * share)
    return round(red * 255), round(green * 255), round(blue * 255)


class WordNumbers:
    """The numbers of the words of a drive, in the order in which they are met; 0 words at first."""

    def __init__(self) -> None:
        """Start with no word at all."""
        self._number: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._number)

    def numbers(self, words: tuple[str, ...], word_index: Ints) -> Ints:
        """Return (n,) the number of the word of each point.

        Args:
            words: Names.
            word_index: (n,) place of each in `words`, -1 for none.
        """
        of_words = [self._number.setdefault(word, _WORD + 1 + len(self._number)) for word in words if word]
        table = np.array([*(of_words.pop(0) if word else _WORD for word in words), _WORD])
        return table[word_index]  # the last entry is that of -1

    def entries(self) -> Iterator[Entry]:
        """Yield the words that were met."""
        yield Entry(_WORD, "no word", _GREY)
        for place, (word, number) in enumerate(self._number.items()):
            yield Entry(number, word, colours.class_colour(place, word))


def layers_of(points: FramePoints) -> dict[str, Array]:
    """Return the numbers of the n points in each layer that there is, but for the words.

    Args:
        points: The points of one frame.
    """
    layers: dict[str, Array] = {}
    if points.flow_mps is not None:
        layers["flow"] = _flow_numbers(points.flow_mps)
    if points.height_m is not None:
        steps = (np.asarray(points.height_m, dtype=np.float32) - _LOWEST_M) / _HEIGHT_STEP_M
        layers["height"] = _HEIGHT + np.clip(np.nan_to_num(steps).round(), 0, _HEIGHT_STEPS - 1).astype(int)
    if points.is_ground is not None:
        layers["ground"] = _GROUND + points.is_ground.astype(int)
    if points.is_moving is not None and points.background is not None:
        state = np.select([points.is_moving, points.background == 0, points.background == 1], [0, 1, 2], 3)
        layers["moving"] = _MOTION + state
    share = np.sqrt(np.clip(np.nan_to_num(points.points.intensity), 0, 1))  # dull returns are the most
    layers["intensity"] = _INTENSITY + (share * (_INTENSITY_STEPS - 1)).round().astype(int)
    return layers


def _flow_numbers(flow_mps: Array) -> Ints:
    x_mps, y_mps = np.nan_to_num(np.asarray(flow_mps, dtype=np.float32)[:, :2]).T
    level = np.searchsorted(_SPEEDS_MPS, np.hypot(x_mps, y_mps), side="right")
    sector = np.round(np.arctan2(y_mps, x_mps) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    return np.asarray(np.where(level == 0, _FLOW, _FLOW + sector * len(_SPEEDS_MPS) + level))
