"""What is asked for, from phrases and files, and what it competes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from stored import config

from command import make_workspace
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes, classes_from_file, classes_from_phrases
from upvl_cli.query.vocabulary import Vocabulary, _vectors, build_vocabulary


def test_phrases_are_a_class_each() -> None:
    assert classes_from_phrases(["fire truck", "car, bus"]).words == {
        "fire truck": ("fire truck",),
        "car": ("car",),
        "bus": ("bus",),
    }


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            'negatives = ["tree"]\n[truck]\nwords = ["truck", " lorry "]\n[bus]\nwords = ["bus"]\nnegatives = ["road"]',
            Classes({"truck": ("truck", "lorry"), "bus": ("bus",)}, ("tree", "road")),
        ),
        ('[a]\nwords = ["b"]', Classes({"a": ("b",)}, None)),
    ],
)
def test_a_file_of_classes(tmp_path: Path, text: str, expected: Classes) -> None:
    path = tmp_path / "classes.toml"
    path.write_text(text)
    assert classes_from_file(path) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[a\n", "is not valid TOML"),
        ("", "it has no class"),
        ('negatives = ["tree"]', "it has no class"),
        ('truck = ["lorry"]', "truck is no table with words"),
        ("[a]", "a.words must be a list of words"),
        ("[a]\nwords = []", "a.words must be a list of words"),
        ('[a]\nwords = "car"', "a.words must be a list of words"),
        ('[a]\nwords = ["car", ""]', "a.words must be texts, none of them empty"),
        ("[a]\nwords = [1]", "a.words must be texts"),
        ('[a]\nwrods = ["car"]', "unknown key a.wrods .*; a.words must be a list of words"),
        ('[a]\nwords = ["car"]\nnegatives = 3', "a.negatives must be a list of words"),
        ('[a]\nwords = ["car"]\n[b]\nwords = ["car"]', "'car' stands 2 times"),
    ],
)
def test_a_malformed_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "classes.toml"
    path.write_text(text)
    with pytest.raises(BadSetting, match=f"classes.toml.*{message}"):
        classes_from_file(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    folder = tmp_path_factory.mktemp("words")
    return Workspace(PIPELINE, make_workspace(folder) / "stages", folder / "out")


def build(made: Workspace, classes: Classes, *, check_spelling: bool = True, **values: float) -> Vocabulary:
    return build_vocabulary(made, classes, config(made, **values), check_spelling=check_spelling)


@pytest.mark.parametrize(
    ("asked", "there", "not_there"),
    [
        ("garbage truck", {"truck", "bus", "car", "road"}, set()),  # its hypernym competes
        ("fire truck", {"truck", "bus", "car", "road"}, {"fire truck"}),
        ("red truck", {"bus", "car", "road"}, {"red truck", "truck"}),  # to mini they are one
        ("truck", {"bus", "car"}, {"truck", "fire truck", "pickup truck"}),  # hyponyms
        ("lorry", {"bus", "car"}, {"truck"}),  # a synonym
        ("vehicle", {"person", "tree"}, {"car", "bus", "van"}),  # a list of name.toml by its name
        ("hydrant", {"car", "truck", "pole", "trash can"}, set()),
    ],
)
def test_a_phrase_competes_with_what_is_something_else(
    made: Workspace, asked: str, there: set[str], not_there: set[str]
) -> None:
    found = build(made, classes_from_phrases([asked]))
    assert there <= set(found.words[1:])
    assert not not_there & set(found.words[1:])
    assert found.class_of_word.tolist() == list(range(len(found.words)))
    assert len(found.vectors) == len(found.words)


def test_words_that_the_model_cannot_distinguish_are_named(made: Workspace) -> None:
    found = build(made, classes_from_phrases(["red truck, garbage truck, car"]))
    assert found.ambiguous == (("red truck", "truck"),)
    assert build(made, classes_from_phrases(["red truck"]), synonym_cosine=1.0).ambiguous == ()


def test_the_word_itself_never_competes_however_it_is_written(made: Workspace) -> None:
    found = build(made, classes_from_phrases(["CAR"]), synonym_cosine=1.5)
    assert found.words[0] == "CAR"
    assert "car" not in found.words[1:]
    assert "van" in found.words[1:]


@dataclass(frozen=True)
class OneHot:
    """A model whose vectors have one number that is not 0; it has none for "void"."""

    name = "one-hot"

    def embed_text(self, words: Sequence[str]) -> np.ndarray:
        return np.array([[float(word != "void"), 0.0, 0.0] for word in words])


def test_a_vector_with_zeros_is_a_vector_and_one_of_zeros_is_none() -> None:
    assert _vectors(OneHot(), ["car", "bus"]).shape == (2, 3)
    with pytest.raises(BadSetting, match="one-hot has no vector for 'void'"):
        _vectors(OneHot(), ["car", "void"])


def test_negatives_of_a_file_are_the_only_ones(made: Workspace) -> None:
    classes = Classes({"large": ("bus", "truck"), "small": ("car",)}, ("tree", "road"))
    found = build(made, classes)
    assert found.words == ("bus", "truck", "car", "tree", "road")
    assert found.class_of_word.tolist() == [0, 0, 1, 2, 3]
    assert found.is_queried.tolist() == [True, True, True, False, False]


def test_words_that_are_none_are_refused(made: Workspace) -> None:
    with pytest.raises(BadSetting, match='no such word: "trcuk"; did you mean "truck"'):
        build(made, Classes({"a": ("car",)}, ("trcuk",)))
    assert build(made, classes_from_phrases(["trcuk"]), check_spelling=False).words[0] == "trcuk"
    with pytest.raises(BadSetting, match="mini has no vector for"):
        build(made, classes_from_phrases(["\u200b"]), check_spelling=False)
