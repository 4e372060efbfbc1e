"""What is in a fleet, on tracks of known kinds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from stored import Thing, basis, config, model, workspace

from command import fails, upvl
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.query.config import SuggestConfig
from upvl_cli.query.fleet import FleetTracks, fleet_tracks
from upvl_cli.query.store import open_store
from upvl_cli.query.suggest import FleetWords, fleet_words, suggest

CAR, TREE, PERSON = {"car": 10}, {"tree": 6}, {"pedestrian": 5}
FLEET = {
    "one": [
        Thing(CAR, x_m=10, track=1, frames=(0, 1), score=0.9),
        Thing(CAR, x_m=20, track=2, speed_mps=6, frames=(0, 1), score=0.7),
        Thing(TREE, x_m=30, track=3, frames=(0, 1)),
        Thing({}, x_m=5, track=4),
    ],
    "two": [Thing(CAR, track=1, frames=(1,)), Thing(PERSON, track=2, speed_mps=1.5, frames=(0, 1))],
}


def tracks_of(folder: Path, segments: tuple[str, ...] = ()) -> FleetTracks:
    return fleet_tracks(open_store(workspace(folder, FLEET, frames=2), None), segments)


def test_tracks_are_pooled_over_their_boxes(tmp_path: Path) -> None:
    made = workspace(
        tmp_path,
        {
            "one": [
                Thing({"car": 30}, track=1, frames=(0,), speed_mps=1, score=0.5),
                Thing({"bus": 10}, track=1, frames=(1,), speed_mps=3, score=0.9),
                Thing({"tree": 4}, frames=(0,)),
                Thing({"tree": 4}, frames=(0,)),
            ]
        },
        frames=2,
    )
    found = fleet_tracks(open_store(made, None), ())
    assert found.track_id.tolist() == [-1, -1, 1]  # boxes without a track are each one of their own
    assert found.boxes.tolist() == [1, 1, 2]
    assert found.frame[2] == 0  # most of its points are there
    np.testing.assert_allclose([found.speed_mps[2], found.confidence[2]], [2, 0.7], rtol=1e-6)
    words = model().embed_text(["car", "bus"])
    expected = 0.75 * words[0] + 0.25 * words[1]  # by points
    cosine = found.vector[2] @ basis().compact_words(expected[None] / np.linalg.norm(expected))[0]
    assert cosine > 0.98
    assert np.isnan(found.spread[0])
    assert 0 < found.spread[2] < 0.5


def test_kinds_are_clusters_with_their_words(tmp_path: Path) -> None:
    made = workspace(tmp_path, FLEET, frames=2)
    tracks = fleet_tracks(open_store(made, None), ())
    words = fleet_words(made, basis())
    found = suggest(tracks, words, config(made).suggest, None)
    named = [words.street[number] for number in found.word[:, 0]]
    assert named[0] == "car"
    assert len(named) == 3
    assert "tree" in named
    assert set(named) & {"human", "person", "pedestrian"}
    assert found.fits_word.all()
    cars = found.cluster_of_track == 0
    assert sorted(zip(tracks.segment[cars].tolist(), tracks.track_id[cars].tolist(), strict=True)) == [
        ("one", 1), ("one", 2), ("two", 1),
    ]  # fmt: skip


def test_of_words_that_tie_the_most_general_is_first() -> None:
    def around(*degrees: float) -> np.ndarray:
        vectors = np.zeros((len(degrees), COMPONENTS + 1))
        vectors[:, 0], vectors[:, 1] = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        return vectors

    tracks = FleetTracks(
        np.array(["one"]), [1], [1], [0], np.ones((1, 3)), [0], [1], around(0), [np.nan]
    )  # fmt: skip
    street = ("vehicle", "car", "sedan", "tree", "bush")  # cosines .966, .985, .996, .5, .17
    words = FleetWords(street, around(15, 10, 5, 60, 80), ("violin",), around(90))
    settings = SuggestConfig(
        spread_quantile=0.9, neighbor_quantile=0.75, max_groups=10, tie_cosine=0.02, words=3
    )
    found = suggest(tracks, words, settings, None)
    assert [street[number] for number in found.word[0]] == ["car", "sedan", "vehicle"]
    np.testing.assert_allclose(found.cosine[0], np.cos(np.deg2rad([10, 5, 15])), rtol=1e-6)


def test_a_thing_of_no_street_fits_no_word(tmp_path: Path) -> None:
    made = workspace(tmp_path, FLEET, frames=2)
    tracks = fleet_tracks(open_store(made, None), ())
    words = fleet_words(made, basis())
    violin = words.unrelated_vectors[words.unrelated.index("violin")]
    strange = FleetTracks(
        **{name: getattr(tracks[:1], name) for name in tracks.__dataclass_fields__ if name != "vector"},
        vector=(violin / np.linalg.norm(violin))[None],
    )
    found = suggest(strange, words, config(made).suggest, None)
    assert words.unrelated[found.unrelated[0]] == "violin"
    assert found.fits_word.tolist() == [False]


def test_compact_vectors_have_the_cosines_of_full_ones() -> None:
    """Against the plain way, in the full space."""
    rng = np.random.default_rng(0)
    values = basis().project(rng.normal(size=(20, model().dim)))
    words = model().embed_text(["car", "tree", "violin"])
    full = basis().mean + values @ basis().components
    full /= np.linalg.norm(full, axis=1, keepdims=True)
    compact = basis().compact(values)
    np.testing.assert_allclose(compact @ compact.T, full @ full.T, atol=1e-5)
    np.testing.assert_allclose(compact @ basis().compact_words(words).T, full @ words.T, atol=1e-5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("fleet")
    workspace(made, FLEET, frames=2)
    return made


def test_the_command_prints_a_line_a_cluster_and_writes_both_tables(folder: Path) -> None:
    done = upvl(folder, "words", "--suggest")
    assert done.returncode == 0, done.stderr
    heading, first, *_, summary, clusters, tracks = done.stdout.splitlines()
    assert heading.split()[:4] == ["nearest", "words", "tracks", "boxes"]
    assert first.startswith("car ")
    assert first.split()[-13:-5] == ["3", "5", "2", "33%", "4.0", "x", "2.0", "x"]
    assert summary.startswith(
        "9 labels with features, 5 tracks in 3 clusters; 0 clusters with 0 tracks fit no word"
    )
    assert (clusters, tracks) == ("out/query/suggest.parquet", "out/query/suggest-tracks.parquet")
    rows = pq.read_table(folder / clusters).to_pylist()
    assert [(row["tracks"], row["boxes"], row["drives"]) for row in rows][0] == (3, 5, 2)
    assert rows[0]["words"][0] == "car"
    np.testing.assert_allclose(rows[0]["moving_share"], 1 / 3)
    assert all(row["fits_word"] for row in rows)
    members = pq.read_table(folder / tracks).to_pylist()
    assert [row["cluster"] for row in members] == [0, 0, 1, 0, 2]
    assert (members[3]["segment"], members[3]["track_id"], members[3]["frame"]) == ("two", 1, 1)


def test_the_number_of_clusters_and_the_drives_can_be_given(folder: Path) -> None:
    done = upvl(folder, "words", "--suggest", "--clusters", "1", "-s", "two")
    assert "3 labels with features, 2 tracks in 1 clusters" in done.stdout


def test_the_same_fleet_gives_the_same_bytes(folder: Path) -> None:
    upvl(folder, "words", "--suggest")
    before = (folder / "out/query/suggest.parquet").read_bytes()
    upvl(folder, "words", "--suggest", OMP_NUM_THREADS="2")
    assert (folder / "out/query/suggest.parquet").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["words"], 'no word is given; name some: upvl words "car, truck", or ask: upvl words --suggest'),
        (["words", "car", "--suggest"], "both WORDS and --suggest are given"),
        (["words", "car", "--clusters", "3"], "--clusters is given without --suggest"),
        (["words", "--suggest", "-s", "tow"], "unknown segment 'tow'"),
        (["words", "--suggest", "--on", "boxes"], "--on boxes: expected labels or detections"),
    ],
)
def test_what_cannot_be_suggested_is_one_line(folder: Path, arguments: list[str], message: str) -> None:
    assert message in fails(folder, *arguments)


def test_boxes_without_features_say_what_to_run(tmp_path: Path) -> None:
    workspace(tmp_path, {"one": [Thing({}, track=1)]})
    assert "none of the labels has a feature; run: upvl autolabel" in fails(tmp_path, "words", "--suggest")
