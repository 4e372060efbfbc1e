"""The layers of points: in each of them a point has one colour, and a point shows the name of its word."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Sequence

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.types import Array, Ints
from upvl_cli.viewer.drive_tables import FramePoints

_STILL_MPS = 0.5
_SPEEDS_MPS = (_STILL_MPS, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0)
_SECTORS = 16  # of directions
_LOWEST_M, _HIGHEST_M = -1.0, 5.0
_STEPS = 64  # of a ramp
_GREY: colours.Colour = (110, 116, 128)
_EARTH: colours.Colour = (150, 112, 70)
_OBJECT: colours.Colour = (70, 150, 240)

LEGEND = f"""# Colours of the points

| view | colours |
| --- | --- |
| words | the word of each point: rest the mouse on a point to read it; grey for none |
| flow | direction of motion over the ground: red ahead of the car, green to the left, cyan towards it, violet to the \
right; the faster, the stronger; grey below {_STILL_MPS} m/s |
| height | height above the ground, from blue ({_LOWEST_M:g} m) over green to red ({_HIGHEST_M:g} m and more) |
| ground | brown ground, light what stands on it |
| moving | orange moving, blue standing objects, grey background, dark unknown |
| intensity | strength of the return, from blue (0) to red (1), as its square root |

Boxes: blue vehicles, red pedestrians, orange cyclists, violet others, grey where no camera saw the track. Rest the
mouse on a box to read its track, class, word, score and speed. The past of each track is a line in a colour of its
own, and the way of the car is white.
"""


def layer_colours(points: FramePoints) -> dict[str, Ints]:
    """Return (n,) the colours of the n points in each layer that there is, but for the words.

    Args:
        points: The points of one frame.
    """
    layers: dict[str, Ints] = {}
    if points.flow_mps is not None:
        layers["flow"] = _FLOW[_flow_steps(points.flow_mps)]
    if points.height_m is not None:
        height_m = np.asarray(points.height_m, dtype=np.float32)
        layers["height"] = _ramp_colours((height_m - _LOWEST_M) / (_HIGHEST_M - _LOWEST_M))
    if points.is_ground is not None:
        layers["ground"] = _packed([colours.STATIC, _EARTH])[points.is_ground.astype(int)]
    if points.is_moving is not None and points.background is not None:
        state = np.select([points.is_moving, points.background == 0, points.background == 1], [0, 1, 2], 3)
        layers["moving"] = _packed([colours.MOVING, _OBJECT, _GREY, colours.GROUND])[state]
    # Dull returns are the most: the root spreads them.
    layers["intensity"] = _ramp_colours(np.sqrt(np.maximum(np.nan_to_num(points.points.intensity), 0)))
    return layers


def _packed(listed: Sequence[colours.Colour]) -> Ints:
    """Return colours as the viewer takes them: one number each, red first and opacity last."""
    return np.array(
        [(red << 24) | (green << 16) | (blue << 8) | 255 for red, green, blue in listed], np.uint32
    )


def _hsv(hue: float, saturation: float, value: float) -> colours.Colour:
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return round(red * 255), round(green * 255), round(blue * 255)


_RAMP = _packed([_hsv(0.68 * (1 - s), 0.85, 0.65 + 0.35 * s) for s in np.linspace(0, 1, _STEPS).tolist()])
_FLOW = _packed(
    [
        _GREY,
        *(
            _hsv(sector / _SECTORS, 0.35 + 0.6 * level / len(_SPEEDS_MPS), 1.0)
            for sector in range(_SECTORS)
            for level in range(1, len(_SPEEDS_MPS) + 1)
        ),
    ]
)


def _ramp_colours(share: Array) -> Ints:
    steps = np.clip(np.nan_to_num(share), 0, 1) * (_STEPS - 1)
    return np.asarray(_RAMP[steps.round().astype(int)])


def _flow_steps(flow_mps: Array) -> Ints:
    x_mps, y_mps = np.nan_to_num(np.asarray(flow_mps, dtype=np.float32)[:, :2]).T
    level = np.searchsorted(_SPEEDS_MPS, np.hypot(x_mps, y_mps), side="right")
    sector = np.round(np.arctan2(y_mps, x_mps) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    return np.asarray(np.where(level == 0, 0, sector * len(_SPEEDS_MPS) + level))


class WordNumbers:
    """The numbers and colours of the words of a drive, in the order in which they are met."""

    def __init__(self) -> None:
        """Start with no word but the empty one, whose number is 0."""
        self._words: dict[str, int] = {"": 0}

    def __len__(self) -> int:
        return len(self._words)

    def numbers(self, words: Sequence[str], word_index: Ints) -> Ints:
        """Return (n,) the number of the word of each point, 0 for none.

        Args:
            words: Names.
            word_index: (n,) place of each in `words`, -1 for none.
        """
        numbers = [self._words.setdefault(word, len(self._words)) for word in words]
        return np.array([*numbers, 0])[word_index]  # the last entry is that of -1

    @property
    def palette(self) -> Ints:
        """(w,) the colour of each number."""
        return _packed([colour for _, _, colour in self.entries()])

    def entries(self) -> Iterator[tuple[int, str, colours.Colour]]:
        """Yield number, name and colour of each word."""
        for word, number in self._words.items():
            yield number, word or "no word", colours.class_colour(number - 1, word) if word else _GREY
