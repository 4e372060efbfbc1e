"""The colours of points in each layer."""

from __future__ import annotations

import colorsys
from typing import Any

import numpy as np

from upvl_cli.types import Points, empty
from upvl_cli.viewer.drive_tables import FramePoints
from upvl_cli.viewer.layers import WordNumbers, layer_colours


def frame_points(intensity: list[float], **known: Any) -> FramePoints:
    n = len(intensity)
    points = Points(np.zeros((n, 3)), np.array(intensity), np.zeros(n), np.zeros(n), np.zeros(n))
    nothing = dict.fromkeys(("flow_mps", "height_m", "is_ground", "is_moving", "background", "word_index"))
    return FramePoints(points, words=(), **{**nothing, **known})


def hue_deg(packed: int) -> float:
    red, green, blue, opacity = packed.to_bytes(4, "big")
    assert opacity == 255
    return 360 * colorsys.rgb_to_hsv(red, green, blue)[0]


def hues_deg(colours: np.ndarray) -> list[int]:
    return [round(hue_deg(int(colour))) for colour in colours]


def test_a_drive_alone_has_intensities() -> None:
    layers = layer_colours(frame_points([0.0, 1.0, 7.0, np.nan]))
    assert list(layers) == ["intensity"]
    low, high, above, unknown = layers["intensity"].tolist()
    assert hue_deg(low) > 200 > 10 > hue_deg(high)  # blue to red
    assert (above, unknown) == (high, low)
    assert layer_colours(FramePoints(empty(Points), None, None, None, None, None, (), None)).keys() == {
        "intensity"
    }


def test_flow_has_the_hue_of_its_direction_and_the_strength_of_its_speed() -> None:
    flow_mps = np.array([[0.1, 0, 9.0], [5, 0, 0], [0, 5, 0], [-5, 0, 0], [0, -5, 0], [20, 0, 0]], np.float16)
    colours = layer_colours(frame_points([0.5] * 6, flow_mps=flow_mps))["flow"]
    assert hues_deg(colours[1:5]) == [0, 90, 180, 270]  # ahead, left, back, right
    faint, strong = (int(colours[place]) & 0xFF00 for place in (1, 5))
    assert strong < faint  # less green beside the red
    assert colours[0] != colours[1]


def test_heights_ground_and_motion() -> None:
    layers = layer_colours(
        frame_points(
            [0.5] * 4,
            height_m=np.array([-1.0, 2.0, 5.0, 50.0], np.float16),
            is_ground=np.array([True, False, False, True]),
            is_moving=np.array([True, False, False, False]),
            background=np.array([-1, 0, 1, -1]),
        )
    )
    low, middle, high, higher = hues_deg(layers["height"])
    assert low > middle > high == higher == 0
    ground = layers["ground"].tolist()
    assert ground[0] == ground[3] != ground[1] == ground[2]
    assert len(set(layers["moving"].tolist())) == 4


def test_words_keep_number_and_colour_over_frames() -> None:
    numbers = WordNumbers()
    assert numbers.numbers(("car", "tree"), np.array([1, -1, 0])).tolist() == [2, 0, 1]
    assert numbers.numbers(("", "bus", "tree"), np.array([0, 1, 2, -1])).tolist() == [0, 3, 2, 0]
    assert [(number, name) for number, name, _ in numbers.entries()] == [
        (0, "no word"), (1, "car"), (2, "tree"), (3, "bus"),
    ]  # fmt: skip
    assert len(numbers.palette) == len(set(numbers.palette.tolist())) == 4
