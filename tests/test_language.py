"""The field's names: what the glossary of the house replaced does not come back, in code, settings or help."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "src" / "upvl_cli").rglob("*.py"))
TOML = sorted((ROOT / "stages").rglob("*.toml"))

# What a word was used for, and the field's name of it, for those who look for the reason of a failure.
REPLACED = {
    "seven": "Boxes: center_m, size_lwh_m, heading_rad",
    "sevens": "Boxes: center_m, size_lwh_m, heading_rad",
    "whole": "scope='dataset', atomic, complete",
    "Lesson": "TrainState",
    "Plan": "a config",
    "Exercise": "(batch, targets)",
    "Team": "ProcessGroup",
    "learn": "train",
    "says": "a head, or a prediction",
    "tells": "a head, or a prediction",
    "told": "prediction, or message",
    "trust": "pseudo_label_min_score",
    "distil": "distillation",
    "each_cell": "anchors_per_cell",
    "Alike": "ShapeClassifier",
    "alike": "shape_classifier",
    "remembered": "PlaceMemory",
    "remember": "place_memory",
    "Unseen": "BackgroundCompletion",
    "no_view": "unseen_policy",
    "contents": "fingerprint",
    "stamps": "provenance",
    "kept_sweeps": "sweep_cache",
    "forecast": "estimate_size",
    "foretell": "estimate_size",
    "calibrate": "fit_background_threshold",
    "describe": "pool-features",
    "agility_m2ps3": "acceleration_psd_m2ps3",
    "min_follow": "min_path_slope",
    "foot_m": "ground_clearance_m",
    "LOOK": "vl_dims",
    "joined": "concat",
    "posed": "transform",
    "settled": "a verb",
    "refined": "a verb",
}
# As words of the settings of `train` they mean something private; elsewhere they are plain words.
REPLACED_SETTINGS = {"encoder", "rate", "paste", "keep_sweeps"}


def identifiers(path: Path) -> Iterator[str]:
    """Names that a file defines or uses: variables, attributes, parameters, functions, classes, keywords."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg
        elif isinstance(node, ast.alias):
            yield from (node.asname or node.name).split(".")


FOREIGN = {"viewer": {"contents"}}  # names of parameters of a library that a folder uses


def test_no_replaced_word_is_an_identifier() -> None:
    def replaced(path: Path) -> dict[str, str]:
        words = set(REPLACED) - FOREIGN.get(path.parent.name, set())
        found = {name.lstrip("_") for name in identifiers(path)} & words
        return {name: REPLACED[name] for name in found}

    found = {str(path.relative_to(ROOT)): replaced(path) for path in MODULES}
    assert not {path: words for path, words in found.items() if words}


def keys(table: dict[str, object]) -> Iterator[str]:
    for name, value in table.items():
        yield name
        if isinstance(value, dict):
            yield from keys(value)


@pytest.mark.parametrize("path", TOML, ids=lambda path: str(path.relative_to(ROOT / "stages")))
def test_no_replaced_word_is_a_setting(path: Path) -> None:
    assert path.stem not in REPLACED
    assert not set(keys(tomllib.loads(path.read_text()))) & (set(REPLACED) | REPLACED_SETTINGS)


@pytest.mark.parametrize("path", TOML, ids=lambda path: str(path.relative_to(ROOT / "stages")))
def test_no_value_stands_for_off(path: Path) -> None:
    """Off is a boolean or another method, never a huge number."""

    def numbers(value: object) -> Iterator[float]:
        if isinstance(value, dict):
            for item in value.values():
                yield from numbers(item)
        elif isinstance(value, list):
            for item in value:
                yield from numbers(item)
        elif isinstance(value, float):
            yield value

    text = path.read_text()
    assert not [number for number in numbers(tomllib.loads(text)) if abs(number) >= 1000]
    assert not re.search(r"leaves it out|switches it off|turns it off", text)
