"""What is found among things of known kinds."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from stored import Thing, basis, config, model, put, refit, workspace

from upvl_cli.errors import BadInput, BadSetting, NotMade
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes, classes_from_phrases
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import Hits, QueryResult, best_first, find, open_warm_store
from upvl_cli.query.index import indexed_objects
from upvl_cli.query.store import Store, open_store
from upvl_cli.query.vocabulary import Vocabulary, build_vocabulary

THINGS = [
    Thing({"car": 20}, x_m=10, track=1, frames=(0, 1, 2)),
    Thing({"fire truck": 16, "bus": 4}, x_m=30, speed_mps=8, track=2, score=0.5, frames=(1, 2)),
    Thing({"pedestrian": 9}, x_m=5, speed_mps=1.0, track=3),
    Thing({}, x_m=12, track=4),  # nothing of it is seen
    Thing({"bus": 5, "car": 4, "fire truck": 4}, x_m=50, score=0.9),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    others = [Thing({"fire truck": 30}, x_m=20, track=1), Thing({"tree": 30}, x_m=8)]
    folder = tmp_path_factory.mktemp("stored")
    return workspace(folder, {"one": THINGS, "two": others, "void": []}, frames=3)


def vocabulary_of(made: Workspace, *phrases: str) -> Vocabulary:
    return build_vocabulary(made, classes_from_phrases(phrases), config(made), check_spelling=True)


def ask(made: Workspace, *phrases: str, filters: Filters | None = None, **values: object) -> QueryResult:
    vocabulary = vocabulary_of(made, *phrases)
    return find(open_store(made, None), vocabulary, filters or Filters(), config(made, **values))


def keys(found: QueryResult) -> list[tuple[str, int, int]]:
    hits = found.hits
    return list(zip(hits.segment.tolist(), hits.frame.tolist(), hits.box.tolist(), strict=True))


def test_a_phrase_finds_its_boxes_best_first(made: Workspace) -> None:
    found = ask(made, "fire truck")
    assert keys(found)[0] == ("two", 0, 0)
    assert sorted(keys(found)[1:]) == [("one", 1, 1), ("one", 2, 1)]  # equal but for the rounding of features
    np.testing.assert_allclose(found.hits.share, [1, 0.8, 0.8])
    np.testing.assert_allclose(found.hits.score, [1, 0.4, 0.4], atol=1e-6)
    np.testing.assert_allclose(sorted(found.hits.time_s), [0, 0.1, 0.2], atol=1e-9)
    assert found.counts == {"boxes": 10, "without points": 1, "other words": 6, "hits": 3, "filtered out": 0,
                            "below the threshold": 0}  # fmt: skip


def test_every_box_has_one_fate(made: Workspace) -> None:
    found = ask(
        made,
        "fire truck",
        filters=Filters(segments=("one",), max_range_m=40),
        threshold=0.3,
        search=True,
        candidates=2,
    )
    counts = dict(found.counts)
    boxes = counts.pop("boxes")
    assert boxes == sum(counts.values())


def test_words_of_a_class_vote_together(made: Workspace) -> None:
    """Nine of thirteen points are one of two words, though the bus has the most."""
    classes = Classes({"large": ("fire truck", "bus")}, ("car",))
    vocabulary = build_vocabulary(made, classes, config(made), check_spelling=True)
    found = find(open_store(made, None), vocabulary, Filters(), config(made))
    mixed = found.hits[found.hits.center_m[:, 0] == 50]
    np.testing.assert_allclose(mixed.share, [9 / 13])
    assert mixed.word_index.tolist() == [1]


def test_several_phrases_share_the_boxes(made: Workspace) -> None:
    found = ask(made, "pedestrian", "car, bus")
    kinds = {("one", 0, 1): 0, ("one", 0, 0): 1, ("one", 1, 0): 1, ("one", 2, 0): 1, ("one", 0, 3): 2}
    assert dict(zip(keys(found), found.hits.class_index.tolist(), strict=True)) == kinds


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        (Filters(segments=("two",)), [("two", 0, 0)]),
        (Filters(moving=True), [("one", 1, 1), ("one", 2, 1)]),
        (Filters(moving=False), [("two", 0, 0)]),
        (Filters(min_speed_mps=8.0), [("one", 1, 1), ("one", 2, 1)]),
        (Filters(max_speed_mps=7.9), [("two", 0, 0)]),
        (Filters(max_range_m=29.9), [("two", 0, 0)]),
        (Filters(from_s=0.05, to_s=0.15), [("one", 1, 1)]),
        (Filters(min_confidence=0.6), [("two", 0, 0)]),
    ],
)
def test_filters(made: Workspace, filters: Filters, expected: list[tuple[str, int, int]]) -> None:
    assert sorted(keys(ask(made, "fire truck", filters=filters))) == sorted(expected)


def test_the_threshold_is_of_share_times_confidence(made: Workspace) -> None:
    assert len(ask(made, "fire truck", threshold=0.39).hits) == 3
    assert keys(ask(made, "fire truck", threshold=0.41)) == [("two", 0, 0)]


def test_a_search_gives_back_the_features_that_it_has_ranked(made: Workspace) -> None:
    store, search, released = open_store(made, None), config(made, search=True), list[str]()
    warm = replace(open_warm_store(store, search), release=released.append)
    find(store, vocabulary_of(made, "car"), Filters(), search, warm)
    assert sorted(released) == ["one", "two", "void"]


def test_a_search_asks_the_best_box_of_the_best_tracks(made: Workspace) -> None:
    assert {key[0] for key in keys(ask(made, "fire truck", search=True, candidates=1))} == {"two"}
    found = keys(ask(made, "fire truck", search=True, candidates=100))
    assert found[0] == ("two", 0, 0)
    assert len(found) == 2  # the track of two frames counts once


def test_the_mean_feature_decides_alone(made: Workspace) -> None:
    found = ask(made, "fire truck", by="mean")
    assert ("two", 0, 0) in keys(found)
    assert set(found.hits.share.tolist()) == {1.0}


def test_answers_are_those_of_a_plain_loop(made: Workspace) -> None:
    """Point by point, in the full space, without the index."""
    where, vocabulary = open_store(made, None), vocabulary_of(made, "fire truck", "car")
    expected = plain(where, vocabulary, where.basis)
    found = find(where, vocabulary, Filters(), config(made))
    got = dict(zip(keys(found), found.hits.class_index.tolist(), strict=True))
    assert got == expected
    assert len(expected) > 4


def plain(where: Store, vocabulary: Vocabulary, basis: Basis) -> dict[tuple[str, int, int], int]:
    from upvl_cli.stages.rows import ObjectRow

    won = {}
    for name, path in where.paths.items():
        for row in Table(path, ObjectRow):
            for box in range(len(row.boxes)):
                votes: dict[int, int] = {}
                for code in row.point_feature.values[row.point_feature.owner == box]:
                    full = basis.mean + (code * basis.scale) @ basis.components
                    kind = int(vocabulary.class_of_word[(vocabulary.vectors @ full).argmax()])
                    votes[kind] = votes.get(kind, 0) + 1
                best = [kind for kind, count in votes.items() if count == max(votes.values())]
                if len(best) == 1 and best[0] < len(vocabulary.class_names):  # ties are tested apart
                    won[name, row.frame, box] = best[0]
    return won


def test_nothing_is_asked_of_the_drives_themselves(made: Workspace) -> None:
    """These three drives do not exist: a query needs no sweep and no picture."""
    with pytest.raises(BadSetting, match="unknown segment 'one'"):
        made.drive("one")
    assert len(ask(made, "car").hits) == 3


def test_detections_come_before_labels(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 5})]})
    put(made, "one", [Thing({"bus": 5}), Thing({"bus": 5})], stage="detect")
    assert (open_store(made, None).source, open_store(made, "labels").source) == ("detections", "labels")
    assert len(ask(made, "bus").hits) == 2


def test_without_a_feature_there_is_nothing_to_ask(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({}), Thing({})]})
    with pytest.raises(BadInput, match="none of the labels has a feature"):
        ask(made, "car")


def test_features_of_another_model_or_basis_are_refused(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 5})]})
    path = made.shard("pca", "all")
    content = path.read_bytes()
    refit(made, json.dumps({"vlm": {"model": "clip"}}))
    with pytest.raises(NotMade, match="was made with another model than that of .*vlm.toml"):
        open_store(made, None)
    refit(made, json.dumps({"vlm": made.model_stamp, "values": 2}))
    with pytest.raises(NotMade, match=r"one.parquet was made before the last pca; run: upvl autolabel"):
        ask(made, "car")
    path.write_bytes(content)
    assert len(ask(made, "car").hits) == 1


def test_the_index_follows_the_shards(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 5})], "two": [Thing({"car": 5})]})
    where = open_store(made, None)
    assert [(name, len(objects)) for name, objects in indexed_objects(where)] == [("one", 1), ("two", 1)]
    (path,) = where.index.iterdir()
    first = path.stat()
    list(indexed_objects(where))
    assert path.stat().st_ino == first.st_ino  # nothing changed: not written again
    put(made, "two", [Thing({"car": 5}), Thing({"bus": 5})])
    put(made, "three", [Thing({"bus": 5})])
    made.shard("pool-features", "one").unlink()
    assert [(name, len(objects)) for name, objects in indexed_objects(open_store(made, None))] == [
        ("three", 1),
        ("two", 2),
    ]


@pytest.mark.parametrize("content", [b"", b"ARROW1\0\0 and then nothing", None])
def test_a_damaged_index_is_made_again(tmp_path: Path, content: bytes | None) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 5})]})
    where = open_store(made, None)
    list(indexed_objects(where))
    (path,) = where.index.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    assert [len(objects) for _, objects in indexed_objects(where)] == [1]


def test_what_moves_is_decided_by_the_setting(made: Workspace) -> None:
    parked = ask(made, "fire truck", filters=Filters(moving=False), moving_mps=8.5)
    assert sorted(keys(parked)) == [("one", 1, 1), ("one", 2, 1), ("two", 0, 0)]
    moving = ask(made, "fire truck", filters=Filters(moving=True), moving_mps=8.0)
    assert sorted(keys(moving)) == [("one", 1, 1), ("one", 2, 1)]


def test_hits_carry_their_boxes(tmp_path: Path) -> None:
    thing = Thing({"car": 6}, x_m=12, y_m=-3, speed_mps=2, speed_y_mps=1, track=7, score=0.5, frames=(1,))
    made = workspace(tmp_path, {"one": [Thing({"tree": 4}), thing]}, frames=2)
    hit = ask(made, "car").hits
    assert (hit.segment[0], hit.frame[0], hit.box[0], hit.track_id[0]) == ("one", 1, 0, 7)
    np.testing.assert_allclose(hit.center_m, [[12, -3, 0]])
    np.testing.assert_allclose(hit.size_lwh_m, [[4, 2, 1.5]])
    np.testing.assert_allclose(hit.velocity_mps, [[2, 1, 0]])
    np.testing.assert_allclose([hit.confidence[0], hit.share[0], hit.score[0]], [0.5, 1, 0.5])
    assert hit.num_features.tolist() == [6]
    np.testing.assert_allclose(hit.time_s, [0.1])


def test_hits_are_ordered_by_score_then_cosine_then_position(tmp_path: Path) -> None:
    """Equal things in two drives and two frames; one of half the confidence; one whose points are mixed."""
    same = Thing({"car": 1}, frames=(0, 1))
    things = [same, same, Thing({"car": 1}, score=0.5), Thing({"car": 3, "tree": 1})]
    made = workspace(tmp_path, {"b": things, "a": [same]}, frames=2)
    hits = ask(made, "car").hits
    order = list(zip(-hits.score, -hits.cosine, hits.segment, hits.frame, hits.box, strict=True))
    assert order == sorted(order)
    assert len(hits) == 8 and len(set(hits.cosine.tolist())) > 1
    assert hits.score[-1] == 0.5
    assert hits.score[-2] == 0.75


def test_the_threshold_belongs_to_the_hits(made: Workspace) -> None:
    at = ask(made, "fire truck", threshold=1.0)
    assert keys(at) == [("two", 0, 0)]
    assert at.counts["below the threshold"] == 2


def test_each_fate_is_counted(made: Workspace) -> None:
    """Ten boxes: seven in drive one (two frames of the truck), two in two; the void has none."""
    found = ask(made, "fire truck", filters=Filters(segments=("one",), max_range_m=40), threshold=0.41)
    assert found.counts == {
        "boxes": 10,
        "other drives": 2,
        "filtered out": 1,  # the bus at 50 m
        "without points": 1,
        "other words": 4,  # three cars, one pedestrian
        "below the threshold": 2,
        "hits": 0,
    }
    ranked = ask(made, "fire truck", search=True, candidates=3)
    assert ranked.counts["not ranked high enough"] == 9 - 3
    assert sum(items for name, items in ranked.counts.items() if name != "boxes") == 10


def test_tracks_of_two_drives_are_two(tmp_path: Path) -> None:
    """Track 1 of both drives, and two boxes without a track: a search classifies one box each."""
    things = [Thing({"car": 4}, track=1, frames=(0, 1)), Thing({"car": 4}, frames=(0,))]
    made = workspace(tmp_path, {"one": things, "two": things}, frames=2)
    assert len(ask(made, "car", search=True, candidates=50).hits) == 4
    assert len(ask(made, "car", search=True, candidates=3).hits) == 3
    assert len(ask(made, "car", search=False, candidates=3).hits) == 6


def test_a_search_ranks_by_the_mean_feature(tmp_path: Path) -> None:
    """The purest car is ranked first, and cars before trees, whatever their order in the store."""
    things = [
        Thing({"tree": 9}),
        Thing({"car": 5, "tree": 4}),
        Thing({"car": 9}),
        Thing({"car": 6, "tree": 3}),
    ]
    made = workspace(tmp_path, {"one": things})
    found = [keys(ask(made, "car", search=True, candidates=number)) for number in (1, 2, 3)]
    assert found[0] == [("one", 0, 2)]
    assert found[1] == [("one", 0, 2), ("one", 0, 3)]
    assert found[2] == [("one", 0, 2), ("one", 0, 3), ("one", 0, 1)]


def test_the_mean_feature_and_the_vote_can_differ(tmp_path: Path) -> None:
    """By vote a share counts; by mean a box is one vote, so its share is 1."""
    made = workspace(tmp_path, {"one": [Thing({"car": 7, "tree": 3})]})
    assert ask(made, "car", by="vote").hits.share.tolist() == [pytest.approx(0.7)]
    assert ask(made, "car", by="mean").hits.share.tolist() == [1.0]


def test_cosines_in_the_basis_are_those_of_the_full_features() -> None:
    """cos(m + W' z, t), against the features put together again in the full space."""
    fitted, words = basis(), model().embed_text(["car", "tree", "road"])
    codes = fitted.quantize(fitted.project(model().embed_text(["bus", "fire truck", "building", "car"])))
    full = fitted.mean + (codes * fitted.scale) @ fitted.components
    expected = full @ words.T / np.linalg.norm(full, axis=1, keepdims=True)
    np.testing.assert_allclose(fitted.cosines(codes, words), expected, atol=1e-5)


def test_a_new_basis_makes_the_index_anew(tmp_path: Path) -> None:
    """Rows of the index are kept by the digests of shard and basis: with the same shard, another basis is refused."""
    made = workspace(tmp_path, {"one": [Thing({"car": 5})]})
    list(indexed_objects(open_store(made, None)))
    refit(made, json.dumps({"vlm": made.model_stamp, "values": 3}))
    with pytest.raises(NotMade, match="was made before the last pca"):
        list(indexed_objects(open_store(made, None)))


def test_an_unchanged_drive_is_copied_from_the_index(tmp_path: Path) -> None:
    """Only the changed shard is read: the other one's columns may be gone, its footer is enough."""
    made = workspace(tmp_path, {"one": [Thing({"car": 5}, track=4)], "two": [Thing({"car": 5})]})
    list(indexed_objects(open_store(made, None)))
    path = made.shard("pool-features", "one")
    content = path.read_bytes()
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    path.write_bytes(b"PAR1" + bytes(footer - 4) + content[footer:])
    put(made, "two", [Thing({"bus": 5}, track=9)])
    found = dict(indexed_objects(open_store(made, None)))
    assert (found["one"].track_id.tolist(), found["two"].track_id.tolist()) == ([4], [9])


def test_the_order_of_hits_by_hand() -> None:
    """Each row beats the next by one column alone, and all later columns speak against it."""
    score = [0.9, 0.8, 0.8, 0.8, 0.8, 0.8]
    cosine = [0.1, 0.7, 0.6, 0.6, 0.6, 0.6]
    segment = ["z", "z", "a", "b", "b", "b"]
    frame = [9, 9, 9, 3, 5, 5]
    box = [9, 9, 9, 9, 1, 2]
    values = {spec.name: np.zeros((6, *spec.metadata["shape"])) for spec in fields(Hits)}
    columns = {"score": score, "cosine": cosine, "segment": segment, "frame": frame, "box": box}
    expected = Hits(**{**values, **{name: np.array(column) for name, column in columns.items()}})
    found = best_first(expected[[3, 5, 0, 4, 2, 1]])
    for name in columns:
        assert getattr(found, name).tolist() == getattr(expected, name).tolist()


def test_a_negative_is_never_a_hit(made: Workspace) -> None:
    """The first negative follows the last class, and wins three boxes."""
    vocabulary = build_vocabulary(made, Classes({"a": ("bus",)}, ("car",)), config(made), check_spelling=True)
    found = find(open_store(made, None), vocabulary, Filters(segments=("one",)), config(made))
    assert set(found.hits.class_index.tolist()) <= {0}
    assert ("one", 0, 0) not in keys(found)
    assert found.counts["other words"] >= 3


def test_a_filtered_box_without_points_has_one_fate(made: Workspace) -> None:
    """The box that nothing is seen of stands at 12 m, behind the bound."""
    found = ask(made, "fire truck", filters=Filters(max_range_m=11))
    assert found.counts["without points"] == 0
    assert sum(items for name, items in found.counts.items() if name != "boxes") == found.counts["boxes"]


def test_a_track_is_found_by_its_looks_though_its_points_vote_otherwise(tmp_path: Path) -> None:
    things = [
        Thing({"car": 18, "fire truck": 2}, track=1, look="fire truck"),
        Thing({"car": 20}, track=2, x_m=20),
        Thing({}, track=3, x_m=30, look="fire truck"),  # no camera sees its points in this frame
    ]
    made = workspace(tmp_path, {"one": things})
    found = ask(made, "fire truck")
    assert found.hits.track_id.tolist() == [3, 1]
    assert found.hits.share[0] > 0.9
    assert found.hits.share[1] == pytest.approx((found.hits.share[0] + 0.1) / 2, abs=0.01)
    assert (found.hits.cosine > 0.5).all()
    assert ask(made, "car").hits.track_id.tolist() == [2]
    # A search ranks by looks too; the mean feature of a box knows none.
    assert ask(made, "fire truck", search=True, candidates=2).hits.track_id.tolist() == [3, 1]
    assert not len(ask(made, "fire truck", by="mean").hits)


def test_looks_count_by_their_weight(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 18, "fire truck": 2}, track=1, look="fire truck")]})
    path = made.stages / "classify.toml"
    text = path.read_text()
    assert "weight = 0.5" in text
    path.write_text(text.replace("weight = 0.5", "weight = 0.0"))
    again = Workspace(made.pipeline, made.stages, made.out)
    (share,) = ask(again, "car").hits.share
    assert share == pytest.approx(0.9)
    assert not len(ask(again, "fire truck").hits)
