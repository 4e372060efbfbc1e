"""Points in the colours of their words, and a legend of those that are there."""

from __future__ import annotations

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import View
from upvl_cli.drawing.words import NO_WORD, words_above, words_in_view

VIEW = View(0, 40, -20, 20)
WORDS = ("road", "gondola", "sleigh")


def colours_of(image: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(colour) for colour in image.reshape(-1, 3).tolist()}


def test_each_point_has_the_colour_of_its_word() -> None:
    xyz = np.array([[20.0, 10, 0], [20, 0, 0], [20, -10, 0]])
    picture = np.asarray(words_above(VIEW, xyz, np.array([0, 2, NO_WORD]), WORDS))
    for (column, row), colour in zip(
        VIEW.pixels(xyz[:, :2]).astype(int),
        (colours.class_colour(0, "road"), colours.class_colour(2, "sleigh"), colours.GROUND),
        strict=True,
    ):
        assert tuple(picture[row, column].tolist()) == colour


def test_the_legend_has_the_words_that_are_there() -> None:
    picture = np.asarray(
        words_in_view(np.zeros((90, 160, 3), np.uint8), np.array([[80.0, 45]]), np.array([2]), WORDS)
    )
    found = colours_of(picture[:60, 6:18])
    assert colours.class_colour(2, "sleigh") in found
    assert colours.class_colour(0, "road") not in found
    nothing = words_above(VIEW, np.zeros((0, 3)), np.zeros(0, int), WORDS)
    assert colours_of(np.asarray(nothing)) == {colours.BACKGROUND}


def test_usual_classes_have_their_colour_wherever_they_stand_and_others_differ() -> None:
    assert colours.class_colour(3, "tree") == colours.class_colour(9, "vegetation")
    assert len({colours.class_colour(number, f"class {number}") for number in range(30)}) == 30
