"""`upvl query --near`: hits that are near others in the same frame."""

from __future__ import annotations

from pathlib import Path

import pytest
from stored import Thing, workspace

from command import fails, upvl


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("near")
    street = [
        Thing({"pedestrian": 9}, x_m=10, y_m=3, track=1),  # a gap of 1 m: things are 4 m long and 2 m wide
        Thing({"pedestrian": 9}, x_m=10, y_m=9, track=2),
        Thing({"bus": 9}, x_m=10, track=3),
    ]
    workspace(made, {"street-0": street, "street-1": street[:1]})
    return made


def test_only_hits_near_the_others_are_kept(folder: Path) -> None:
    done = upvl(folder, "query", "pedestrian", "--near", "bus", "--within", "1.5", "--no-sheet")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[1].split()[:6] == ["pedestrian", "pedestrian", "1.00", "100%", "street-0", "1"]
    assert lines[2] == "4 labels: 1 hits of 1 objects, 1 other words, 2 not near"
    done = upvl(folder, "query", "pedestrian", "--near", "bus", "--within", "7.5", "--no-sheet")
    assert "2 hits of 2 objects" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["--within", "5"],
        ["--near", "bus", "--within", "-1"],
        ["--near", "bus", "--within", "nan"],
        ["--near", "bus", "--within", "inf"],
    ],
)
def test_a_distance_belongs_to_another_object(folder: Path, arguments: list[str]) -> None:
    assert "expected metres from 0 on, together with --near WORDS" in fails(
        folder, "query", "car", *arguments
    )
