"""What is asked for, from phrases and files, and what it competes with."""

from __future__ import annotations

from pathlib import Path

import pytest

from command import make_workspace
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes, of_file, of_phrases
from upvl_cli.query.question import question


def test_phrases_are_a_class_each() -> None:
    assert of_phrases(["fire truck", "car, bus"]).words == {
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
    assert of_file(path) == expected


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
def test_a_malformed_file_is_told_from_a_good_one(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "classes.toml"
    path.write_text(text)
    with pytest.raises(BadSetting, match=f"classes.toml.*{message}"):
        of_file(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    folder = tmp_path_factory.mktemp("words")
    return Workspace(PIPELINE, make_workspace(folder) / "stages", folder / "out")


@pytest.mark.parametrize(
    ("asked", "there", "not_there"),
    [
        ("garbage truck", {"truck", "bus", "car", "road"}, set()),  # a kind of truck is told from trucks
        ("fire truck", {"bus", "car", "road"}, {"fire truck", "truck"}),  # to mini they are one
        ("truck", {"bus", "car"}, {"truck", "fire truck", "pickup truck"}),  # kinds of it
        ("lorry", {"bus", "car"}, {"truck"}),  # says the same
        ("vehicle", {"person", "tree"}, {"car", "bus", "van"}),  # a list of name.toml by its name
        ("hydrant", {"car", "truck", "pole", "trash can"}, set()),
    ],
)
def test_a_phrase_competes_with_what_is_something_else(
    made: Workspace, asked: str, there: set[str], not_there: set[str]
) -> None:
    found = question(made, of_phrases([asked]), same=0.9, anyway=False)
    assert there <= set(found.words[1:])
    assert not not_there & set(found.words[1:])
    assert found.kind_of_word.tolist() == list(range(len(found.words)))
    assert len(found.vectors) == len(found.words)


def test_what_the_model_does_not_tell_apart_is_told(made: Workspace) -> None:
    found = question(made, of_phrases(["fire truck, garbage truck, car"]), same=0.9, anyway=False)
    assert found.blurred == (("fire truck", "truck"),)
    assert question(made, of_phrases(["fire truck"]), same=1.0, anyway=False).blurred == ()


def test_negatives_of_a_file_are_the_only_ones(made: Workspace) -> None:
    classes = Classes({"large": ("bus", "truck"), "small": ("car",)}, ("tree", "road"))
    found = question(made, classes, same=0.9, anyway=False)
    assert found.words == ("bus", "truck", "car", "tree", "road")
    assert found.kind_of_word.tolist() == [0, 0, 1, 2, 3]
    assert found.asked.tolist() == [True, True, True, False, False]


def test_words_that_are_none_are_refused(made: Workspace) -> None:
    with pytest.raises(BadSetting, match='no such word: "trcuk"; did you mean "truck"'):
        question(made, Classes({"a": ("car",)}, ("trcuk",)), same=0.9, anyway=False)
    assert question(made, of_phrases(["trcuk"]), same=0.9, anyway=True).words[0] == "trcuk"
    with pytest.raises(BadSetting, match="mini has no vector for"):
        question(made, of_phrases(["\u200b"]), same=0.9, anyway=True)
