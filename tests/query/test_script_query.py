"""Queries of scripts: what `upvl query` finds, as a table."""

from __future__ import annotations

from pathlib import Path

import pytest
from stored import Thing, workspace

import upvl_cli as upvl
from upvl_cli.errors import BadSetting
from upvl_cli.results.results import Results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Results of two drives, of which one has a fire truck that drives and one that stands."""
    folder = tmp_path_factory.mktemp("scripted")
    street = [
        Thing({"fire truck": 19, "bus": 1}, x_m=12, speed_mps=5, track=7, frames=(0, 1)),
        Thing({"car": 9}, x_m=20),
    ]
    made = workspace(folder, {"street-0": street, "gone": [Thing({"fire truck": 8}, x_m=25)]}, frames=2)
    (made.out / "labels").mkdir()
    (made.out / "labels" / "street-0.parquet").touch()  # what makes a folder one of results
    return upvl.open(folder / "out")


def test_a_query_gives_all_hits_best_first(results: Results) -> None:
    hits = results.query("fire truck").to_pydict()
    assert list(zip(hits["segment"], hits["frame"], hits["track_id"], strict=True)) == [
        ("gone", 0, -1), ("street-0", 0, 7), ("street-0", 1, 7),
    ]  # fmt: skip
    assert hits["class"] == ["fire truck"] * 3
    assert hits["share"] == pytest.approx([1.0, 0.95, 0.95])
    assert hits["center_x_m"] == pytest.approx([25, 12, 12])


def test_filters_and_settings_are_named_as_in_the_settings(results: Results) -> None:
    assert results.query("fire truck", moving=True).num_rows == 2
    assert results.query("fire truck", max_range_m=15.0, to_s=0.05).num_rows == 1
    assert results.query(["fire truck", "car"], segments="street-0").num_rows == 3
    assert results.query("fire truck, car", segments=["gone"]).num_rows == 1
    assert results.query("fire truck", threshold=0.99).num_rows == 1
    assert results.query("fire truck", by="mean", on="labels").num_rows == 3
    assert not list(
        (results.workspace.out / "query").glob("*.png")
    )  # nothing is drawn or written but the index


@pytest.mark.parametrize(
    ("phrases", "options", "message"),
    [
        ("fire truck", {"max_rnge_m": 3}, "query has no option 'max_rnge_m'; did you mean 'max_range_m'"),
        ("fire truck", {"top": 3}, "query has no option 'top'"),
        ("fire trcuk", {}, 'no such word: "trcuk"; did you mean "truck"'),
        ("", {}, "an empty phrase is asked for"),
        ("car", {"segments": "stret-0"}, "unknown segment 'stret-0'"),
        ("car", {"on": "boxes"}, "boxes: expected labels or detections"),
    ],
)
def test_what_cannot_be_asked_is_named(results: Results, phrases: str, options: dict, message: str) -> None:
    with pytest.raises(BadSetting, match=message.replace("(", r"\(")):
        results.query(phrases, **options)


def test_settings_are_found_beside_the_results_or_where_they_are_said_to_be(
    results: Results, tmp_path: Path
) -> None:
    (tmp_path / "out").symlink_to(results.workspace.out)
    with pytest.raises(BadSetting, match="has no raw.toml; queries, points and recordings need the settings"):
        upvl.open(tmp_path / "out").query("car")
    elsewhere = upvl.open(tmp_path / "out", stages=results.workspace.stages)
    assert elsewhere.query("fire truck").num_rows == 3
