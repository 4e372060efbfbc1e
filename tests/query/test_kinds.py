"""The kinds of what is queried."""

from __future__ import annotations

from pathlib import Path

import pytest

from upvl_cli.config.toml import load
from upvl_cli.query.classes import Classes, classes_from_phrases
from upvl_cli.query.kinds import with_kinds
from upvl_cli.stages.classify import ClassifyConfig


@pytest.fixture(scope="module")
def config() -> ClassifyConfig:
    return load(ClassifyConfig, Path(__file__).parents[2] / "stages" / "classify.toml")


def test_a_word_brings_what_narrows_it(config: ClassifyConfig) -> None:
    (words,) = with_kinds(classes_from_phrases(["bus"]), config).words.values()
    assert words[0] == "bus"
    assert {"school bus", "double-decker bus"} <= set(words)
    assert not {"truck", "car", "tram"} & set(words)


def test_who_asks_for_people_asks_for_all_of_them(config: ClassifyConfig) -> None:
    (words,) = with_kinds(classes_from_phrases(["person"]), config).words.values()
    assert {"pedestrian", "child", "stroller"} <= set(words)
    assert not {"cyclist", "car"} & set(words)


def test_a_special_word_stays_alone(config: ClassifyConfig) -> None:
    assert with_kinds(classes_from_phrases(["fire truck"]), config).words == {"fire truck": ("fire truck",)}


def test_a_kind_that_is_asked_for_itself_is_in_one_class(config: ClassifyConfig) -> None:
    words = with_kinds(classes_from_phrases(["bus", "school bus"]), config).words
    assert "school bus" not in words["bus"]
    assert words["school bus"] == ("school bus",)
    every = [word for of in words.values() for word in of]
    assert len(every) == len(set(every))


def test_classes_with_negatives_are_taken_as_they_are(config: ClassifyConfig) -> None:
    given = Classes({"bus": ("bus",)}, ("truck",))
    assert with_kinds(given, config) == given
