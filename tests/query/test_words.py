"""Which boxes words win, on things of known classes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from stored import Thing, config, workspace

from upvl_cli.query.classes import Classes
from upvl_cli.query.filters import Filters
from upvl_cli.query.store import open_store
from upvl_cli.query.vocabulary import build_vocabulary
from upvl_cli.query.words import BINS, word_statistics


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
    asked = build_vocabulary(
        made, Classes({word: (word,) for word in words}, ("tree",)), config(made), check_spelling=True
    )
    found = word_statistics(open_store(made, None), asked, Filters())
    assert found.score_histogram.sum(axis=1).tolist() == [3, 1, 1, 0, 0]
    expected = np.zeros(BINS, int)
    expected[[3, 9]] = 1, 2  # 6 of 10 votes times 0.5, and all of the votes twice
    np.testing.assert_array_equal(found.score_histogram[0], expected)
    assert found.replacements[0] == {1: 3}  # fire trucks become trucks
    assert found.replacements[1] == {0: 1}
    assert not found.replacements[3]
    only_two = word_statistics(open_store(made, None), asked, Filters(segments=("two",)))
    assert only_two.score_histogram.sum(axis=1).tolist() == [1, 0, 0, 0, 0]


def test_without_the_only_word_they_are_nothing(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 3})]})
    asked = build_vocabulary(made, Classes({"car": ("car",)}, ()), config(made), check_spelling=True)
    assert word_statistics(open_store(made, None), asked, Filters()).replacements[0] == {-1: 1}
