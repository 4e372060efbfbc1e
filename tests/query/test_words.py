"""What words are worth, on things of known kinds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from stored import Thing, workspace

from upvl_cli.query.classes import Classes
from upvl_cli.query.find import Filters
from upvl_cli.query.question import question
from upvl_cli.query.store import store
from upvl_cli.query.words import BINS, worth


def test_boxes_fall_to_the_next_word(tmp_path: Path) -> None:
    things = [
        Thing({"fire truck": 10}),
        Thing({"fire truck": 6, "truck": 4}, score=0.5),
        Thing({"truck": 10}),
        Thing({"pedestrian": 10}),
        Thing({}),
    ]
    made = workspace(tmp_path, {"one": things, "two": things[:1]})
    words = ("fire truck", "truck", "pedestrian", "tram")
    asked = question(made, Classes({word: (word,) for word in words}, ("tree",)), same=0.9, anyway=False)
    found = worth(store(made, None), asked, Filters())
    assert found.scores.sum(axis=1).tolist() == [3, 1, 1, 0, 0]
    expected = np.zeros(BINS, int)
    expected[[3, 9]] = 1, 2  # 6 of 10 votes times 0.5, and all of the votes twice
    np.testing.assert_array_equal(found.scores[0], expected)
    assert found.instead[0] == {1: 3}  # fire trucks become trucks
    assert found.instead[1] == {0: 1}
    assert not found.instead[3]
    only_two = worth(store(made, None), asked, Filters(segments=("two",)))
    assert only_two.scores.sum(axis=1).tolist() == [1, 0, 0, 0, 0]


def test_without_the_only_word_they_are_nothing(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 3})]})
    asked = question(made, Classes({"car": ("car",)}, ()), same=0.9, anyway=False)
    assert worth(store(made, None), asked, Filters()).instead[0] == {-1: 1}
