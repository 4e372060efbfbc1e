"""Which words are likely typing errors, and what was meant."""

from __future__ import annotations

import pytest

from upvl_cli.vlm.mini import Mini


@pytest.fixture(scope="module")
def model() -> Mini:
    return Mini()


@pytest.mark.parametrize(
    ("phrase", "expected"),
    [
        ("fire trcuk", [("trcuk", "truck")]),
        ("Fier Truck", [("fier", "fire")]),
        ("vehicel", [("vehicel", "vehicle")]),
        ("a pedestrain and a byciclist", [("pedestrain", "pedestrian"), ("byciclist", "bicyclist")]),
        ("vna", [("vna", "van")]),
        ("trcuk, trcuk", [("trcuk", "truck")]),
        ("xqzzt", [("xqzzt", "")]),
    ],
)
def test_slips_are_found(model: Mini, phrase: str, expected: list[tuple[str, str]]) -> None:
    assert model.unknown_words([phrase]) == expected


@pytest.mark.parametrize(
    "phrase",
    [
        "fire truck",
        "firetruck",
        "The excavators",
        "lorries",
        "ambulances",
        "e-scooter",
        "3.5 t lorry",
        "Café",
        "",
    ],
)
def test_words_are_words(model: Mini, phrase: str) -> None:
    assert model.unknown_words([phrase]) == []
