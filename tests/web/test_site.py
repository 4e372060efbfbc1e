"""Pages of a small workspace: what is found, shown, saved, and said where there is nothing."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from starlette.testclient import TestClient

from query.stored import Thing, put, refit
from query.stored import workspace as stored_workspace
from upvl_cli.pipeline.workspace import Workspace
from web.small_site import FRAMES, STREET, client, label, workspace

NAMES = [
    ("vehicle", "bus"),
    ("vehicle", "car"),
    ("vehicle", "car"),
    ("pedestrian", ""),
    ("pedestrian", ""),
    ("unknown", ""),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    found = workspace(tmp_path_factory.mktemp("site"))
    label(found, "street-0", STREET, NAMES, len(FRAMES))
    return found


@pytest.fixture(scope="module")
def site(made: Workspace) -> TestClient:
    return client(made)


def hits(site: TestClient, query: str) -> list[tuple[str, int, int]]:
    """Drive, frame and track of the hits that a page shows, in order."""
    answer = site.get(f"/?{query}")
    assert answer.status_code == 200, answer.text
    facts = re.findall(r'<p class="facts">(\S+)(?: · track (\d+))? · frame (\d+)', answer.text)
    return [(drive, int(frame), int(track or -1)) for drive, track, frame in facts]


def tracks(site: TestClient, query: str) -> set[tuple[str, int]]:
    return {(drive, track) for drive, _, track in hits(site, query)}


def test_words_find_one_hit_a_track(site: TestClient) -> None:
    found = hits(site, "q=bus&threshold=0.6")
    assert [(drive, track) for drive, _, track in found] == [("gone", 7), ("street-0", 7)]
    assert tracks(site, "q=pedestrian") == {("street-0", 10), ("street-0", 11)}


def test_votes_are_shown(site: TestClient) -> None:
    text = site.get("/?q=bus&drive=street-0").text
    assert re.search(
        r'<tr class="queried">\s*<th scope="row">bus</th>\s*<td><meter [^>]*></meter> 90 %', text
    )
    assert re.search(r'<tr>\s*<th scope="row">car</th>\s*<td><meter [^>]*></meter> 10 %', text)


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("q=bus,car&threshold=0&drive=street-0", {7, 8, 9}),
        ("q=bus,car&threshold=0&drive=street-0&motion=parked", {9}),
        ("q=bus,car&threshold=0&drive=street-0&min_speed=4", {7}),
        ("q=bus,car&threshold=0&drive=street-0&max_speed=4", {8, 9}),
        ("q=bus,car&threshold=0&drive=street-0&max_range=21", {7, 8}),
        ("q=bus,car&threshold=0&drive=street-0&min_score=0.8", {7, 8}),
        ("q=bus,car&threshold=0&drive=street-0&class=pedestrian", set()),
        ("q=bus&not=car,pedestrian&drive=street-0&threshold=0.3", {7}),
        ("class=pedestrian", {10, 11}),
        ("motion=moving", {7, 8}),
        ("from=0.35&class=vehicle", {7, 8}),
        ("drive=street-0&min_score=0&to=0.1", {7, 8, 9, 11, -1}),
        ("q=pedestrian&relation=near&other=bus&within=2", {10}),
        ("q=pedestrian&relation=near&other=bus&within=50", {10, 11}),
        ("class=pedestrian&relation=near&other=bus&within=2", {10}),
    ],
)
def test_filters(site: TestClient, query: str, expected: set[int]) -> None:
    assert {track for _, track in tracks(site, query)} == expected


def test_a_relation_says_what_it_found(site: TestClient) -> None:
    text = site.get("/?q=pedestrian&relation=near&other=bus&within=2").text
    assert "1.0 m from track 7" in text  # 3 m apart, 2 m wide both


def test_a_relation_shows_its_best_moment(tmp_path: Path) -> None:
    """The pedestrian comes nearer to the bus until the third frame, and goes away again."""
    walk = [
        Thing({"pedestrian": 6}, x_m=10, y_m=y, track=1, frames=(n,)) for n, y in enumerate((6, 5, 3.5, 4))
    ]
    drives = [*walk, Thing({"bus": 9}, x_m=10, track=2, frames=(0, 1, 2, 3))]
    drives += [
        Thing({"car": 9}, x_m=30, speed_mps=4 * (frame in (0, 2)), track=3, frames=(frame,))
        for frame in range(8)
    ]
    site = client(stored_workspace(tmp_path, {"a": drives}, 8))
    near = "q=pedestrian&relation=near&other=bus&within=9"
    assert hits(site, near) == [("a", 2, 1)]
    assert "1.5 m from track 2" in site.get(f"/?{near}").text
    stopped = "q=car&relation=stopped&stand=0.35"
    assert hits(site, stopped) == [("a", 3, 3)]
    assert "stands for 0.4 s" in site.get(f"/?{stopped}").text


def test_an_overtaking_is_found(tmp_path: Path) -> None:
    drive = [Thing({"bus": 9}, x_m=0, speed_mps=10, track=1, frames=tuple(range(6)))]
    drive += [
        Thing({"bicycle": 9}, x_m=-12 + 5 * frame, y_m=3, speed_mps=60, track=2, frames=(frame,))
        for frame in range(6)
    ]
    site = client(stored_workspace(tmp_path, {"a": drive}, 6))
    query = "q=bicycle&relation=overtaking&other=bus&within=4"
    assert hits(site, query) == [("a", 3, 2)]
    assert "overtakes track 1 in 0.1 s" in site.get(f"/?{query}").text
    assert hits(site, "q=bus&relation=overtaking&other=bicycle&within=4") == []
    assert hits(site, query.replace("within=4", "within=2")) == []


def test_more_like_this_leaves_its_own_track_out(site: TestClient) -> None:
    found = hits(site, "like=street-0:0:0&source=labels")
    assert found[0][::2] == ("gone", 7)
    assert ("street-0", 7) not in {(drive, track) for drive, _, track in found}
    assert "no feature: no camera shows it" in site.get("/?like=street-0:0:4&source=labels").text


def test_the_threshold_hides_and_the_histogram_keeps(site: TestClient) -> None:
    low, high = (site.get(f"/?q=bus,car&threshold={value}").text for value in ("0", "0.96"))
    assert "4 hits" in low
    assert "1 hit for" in high
    assert "Histogram of the scores of 4 tracks" in low
    assert "Histogram of the scores of 4 tracks" in high


def test_pages(tmp_path: Path) -> None:
    things = [Thing({"bus": 5}, x_m=10 + track, track=track, score=1 - track / 100) for track in range(30)]
    site = client(stored_workspace(tmp_path, {"a": things}))
    found = [hits(site, f"q=bus&page={page}") for page in (1, 2, 3)]
    assert [track for page in found for _, _, track in page] == list(range(30))
    assert hits(site, "q=bus&page=99") == found[2]  # the last one
    assert 'rel="next"' not in site.get("/?q=bus&page=3").text


def test_a_hit_shows_its_track(site: TestClient) -> None:
    text = site.get("/hit/labels/street-0/0/0?q=bus").text
    for part in (
        "<h1>bus</h1>",
        "6 in 0.5 s",
        "Speed of the track over time",
        "Back to the results",
        "Votes in frame 0",
    ):
        assert part in text
    assert 'href="/?q=bus"' in text
    assert 'value="3"' in site.get("/hit/labels/street-0/0/0?at=3").text
    assert "found in frame 0" in site.get("/hit/labels/street-0/0/0?at=3").text


def test_pictures_and_the_scene(site: TestClient) -> None:
    above = Image.open(io.BytesIO(site.get("/above/labels/street-0/0/0").content))
    assert above.size == (308, 308)
    crop = site.get("/crop/labels/street-0/0/0")
    assert crop.headers["Content-Type"] == "image/jpeg"
    assert len(np.unique(np.asarray(Image.open(io.BytesIO(crop.content))).reshape(-1, 3), axis=0)) > 100
    assert site.get("/camera/labels/street-0/0/0").headers["Content-Type"] == "image/jpeg"
    assert site.get("/camera/labels/street-0/0/7").status_code == 400
    plain, framed, other = (
        site.get(f"/camera/labels/street-0/0/0{query}").content for query in ("", "?track=7", "?track=999")
    )
    assert framed != plain
    assert other == plain
    points = np.frombuffer(site.get("/api/points/labels/street-0/0").content, "<i2").reshape(-1, 3)
    assert 100 < len(points) <= 20_000
    assert np.abs(points).max() <= 7500
    scene = site.get("/api/boxes/labels/street-0/0?track=7").json()
    assert scene["boxes"][0] == {
        "center": [14, 1, 0], "size": [4, 2, 1.5], "heading": 0, "speed": 5, "score": 1, "track": 7, "name": "bus",
    }  # fmt: skip
    assert scene["cameras"] == [{"number": 0, "name": "front", "sees": True}]
    assert site.get("/api/track/labels/street-0/7").json()["speed_mps"] == [5] * 6


def test_points_are_those_of_the_sweep(made: Workspace, site: TestClient) -> None:
    sweep = made.drive("street-0").points(2).xyz_ego_m
    sweep = sweep[(np.abs(sweep) <= 75).all(axis=1)]
    points = np.frombuffer(site.get("/api/points/labels/street-0/2").content, "<i2").reshape(-1, 3) / 100
    np.testing.assert_allclose(points[0], sweep[0], atol=0.006)
    np.testing.assert_allclose(points[-1], sweep[-1], atol=0.006)


def test_a_drive_whose_raw_data_are_gone_is_shown_without_pictures(site: TestClient) -> None:
    crop = site.get("/crop/labels/gone/0/0")
    assert crop.status_code == 200
    assert crop.headers["Content-Type"] == "image/svg+xml"
    assert "the raw drive cannot be read" in re.sub(r"(<[^>]*>)+", " ", crop.text)
    assert site.get("/above/labels/gone/0/0").headers["Content-Type"] == "image/png"
    assert "its raw data are not there" in site.get("/hit/labels/gone/0/0").text
    assert site.get("/api/points/labels/gone/0").status_code == 404
    assert site.get("/api/boxes/labels/gone/0").json()["cameras"] == []


def test_hits_are_saved(site: TestClient) -> None:
    rows = list(csv.DictReader(io.StringIO(site.get("/save/hits.csv?q=bus,car&threshold=0").text)))
    table = pq.read_table(io.BytesIO(site.get("/save/hits.parquet?q=bus,car&threshold=0").content))
    assert len(rows) == table.num_rows == 4
    assert list(rows[0]) == table.column_names
    assert [row["segment"] for row in rows] == table.column("segment").to_pylist()
    np.testing.assert_allclose(
        [float(row["score"]) for row in rows], table.column("score").to_pylist(), rtol=1e-5
    )
    assert len(site.get("/save/hits.csv?q=bus,car&threshold=0.96").text.splitlines()) == 2
    assert site.get("/save/hits.exe?q=bus").status_code == 404


def test_words_are_text_and_never_markup(site: TestClient) -> None:
    answer = site.get("/", params={"q": "<script>alert(1)</script>\"'", "anyway": "1"})
    assert answer.status_code == 200
    assert "<script>alert" not in answer.text
    assert "&lt;script&gt;alert(1)" in answer.text


def test_a_misspelt_word_is_named(site: TestClient) -> None:
    answer = site.get("/?q=fire+trcuk")
    assert answer.status_code == 400
    assert "did you mean &#34;truck&#34;?" in answer.text
    assert 'value="fire trcuk"' in answer.text  # what was typed is kept
    assert "--anyway" not in answer.text
    (link,) = re.findall(r'<a href="([^"]+)">Search for it as it is written</a>', answer.text)
    assert site.get(link.replace("&amp;", "&")).status_code == 200


def test_no_hits_are_explained(site: TestClient) -> None:
    assert "Nothing reaches the minimum score" in site.get("/?q=tree").text
    assert "lower the minimum" in site.get("/?q=bus&threshold=1&drive=street-0&class=vehicle").text


def test_a_workspace_without_labels_says_what_to_run(tmp_path: Path) -> None:
    site = client(stored_workspace(tmp_path, {}))
    answer = site.get("/")
    assert answer.status_code == 200
    assert "nothing has been labelled" in answer.text
    assert "upvl autolabel" in answer.text
    assert site.get("/?q=car").status_code == 404


def test_labels_without_features_are_searched_by_filters(tmp_path: Path) -> None:
    made = stored_workspace(tmp_path, {})
    label(made, "street-0", STREET, NAMES, len(FRAMES))
    site = client(made)
    assert "Words cannot be asked here" in site.get("/").text
    assert tracks(site, "class=pedestrian") == {("street-0", 10), ("street-0", 11)}
    assert "words cannot be asked" in site.get("/?q=car").text
    assert site.get("/?q=car").status_code == 404
    assert site.get("/hit/labels/street-0/0/0").status_code == 200


def test_boxes_whose_pictures_were_not_used_have_no_words(tmp_path: Path) -> None:
    site = client(stored_workspace(tmp_path, {"a": [Thing({}, track=1)]}))
    assert "no box has a feature, because no picture was used" in site.get("/").text
    assert tracks(site, "min_score=0") == {("a", 1)}


def test_a_model_that_is_missing_leaves_filters(tmp_path: Path) -> None:
    made = workspace(tmp_path)
    label(made, "street-0", STREET, NAMES, len(FRAMES))
    (tmp_path / "stages" / "vlm.toml").write_text('model = "clip:/no/such/weights"\n')
    site = client(Workspace(made.pipeline, made.stages, made.out))
    answer = site.get("/")
    assert answer.status_code == 200
    assert "Words cannot be asked here" in answer.text
    assert ("street-0", 10) in tracks(site, "class=pedestrian")


def test_shards_that_are_made_again_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("upvl_cli.web.catalog._LOOK_AGAIN_S", 0.0)
    made = stored_workspace(tmp_path, {"a": [Thing({"bus": 5}, track=1)]})
    site = client(made)
    assert tracks(site, "q=bus") == {("a", 1)}
    put(made, "a", [Thing({"bus": 5}, track=2), Thing({"car": 5}, track=3)])
    put(made, "b", [Thing({"bus": 5}, track=9)])
    assert tracks(site, "q=bus") == {("a", 2), ("b", 9)}
    refit(made, "{}")  # another model
    assert "made with another model" in site.get("/?q=bus").text
