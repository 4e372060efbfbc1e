"""Files of vectors: what they hold, when they are made again, and what a search finds by them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from stored import Thing, basis, config, put, workspace

from command import upvl
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes, classes_from_phrases
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import QueryResult, find
from upvl_cli.query.groups import groups_of
from upvl_cli.query.index import open_index
from upvl_cli.query.store import open_store
from upvl_cli.query.vector_build import build_vectors, make_index
from upvl_cli.query.vector_files import DIM, VectorFile, read_stamp, write_vectors
from upvl_cli.query.vector_search import open_vectors
from upvl_cli.query.vocabulary import build_vocabulary

faiss = pytest.importorskip("faiss")

STREET = [
    Thing({"car": 20}, x_m=10, track=1, frames=(0, 1, 2)),
    Thing({"fire truck": 16, "bus": 4}, x_m=30, speed_mps=8, track=2, score=0.5, frames=(1, 2)),
    Thing({"pedestrian": 9}, x_m=5, speed_mps=1.0, track=3),
    Thing({}, x_m=12, track=4, look="fire truck"),
    Thing({"car": 18, "bus": 2}, track=5, x_m=60, look="bus", frames=(0, 2)),
    Thing({"bus": 5, "car": 4}, x_m=50, score=0.9),
]
DRIVES = {"one": STREET, "two": [Thing({"fire truck": 30}, x_m=20, track=1), Thing({"tree": 30})], "void": []}


@pytest.fixture
def made(tmp_path: Path) -> Workspace:
    return workspace(tmp_path, DRIVES, frames=3)


def index(made: Workspace) -> str:
    return list(make_index(made, None))[-1]


def ask(
    made: Workspace,
    *phrases: str,
    filters: Filters | None = None,
    classes: Classes | None = None,
    **values: object,
) -> QueryResult:
    settings = config(made, search=True, **{"index_min_boxes": 0, **values})
    vocabulary = build_vocabulary(
        made, classes or classes_from_phrases(phrases), settings, check_spelling=True
    )
    return find(open_store(made, None), vocabulary, filters or Filters(), settings)


def keys(found: QueryResult) -> list[tuple[str, int, int]]:
    hits = found.hits
    return list(zip(hits.segment.tolist(), hits.frame.tolist(), hits.box.tolist(), strict=True))


def vectors(made: Workspace) -> Path:
    (path,) = (made.out / "query" / "index").glob("*.faiss")
    return path


@pytest.mark.parametrize(
    ("phrases", "filters"),
    [
        (["fire truck"], Filters()),
        (["car", "bus"], Filters()),
        (["fire truck"], Filters(segments=("one",))),
        (["bus"], Filters(max_range_m=55, from_s=0.05)),
        (["car"], Filters(moving=True)),
    ],
)
def test_a_search_by_the_index_finds_what_the_exact_ranking_finds(
    made: Workspace, phrases: list[str], filters: Filters
) -> None:
    exact = ask(made, *phrases, filters=filters)
    assert exact.ranking == "ranked exactly"
    index(made)
    found = ask(made, *phrases, filters=filters)
    assert "by the index" in found.ranking
    assert keys(found) == keys(exact)
    assert found.counts == exact.counts


def test_negatives_and_the_mean_feature_rank_alike(made: Workspace) -> None:
    classes = Classes({"a": ("bus",)}, ("fire truck",))
    exact = [keys(ask(made, classes=classes, candidates=2, by=by)) for by in ("vote", "mean")]
    index(made)
    assert [keys(ask(made, classes=classes, candidates=2, by=by)) for by in ("vote", "mean")] == exact


def test_few_boxes_are_ranked_exactly(made: Workspace) -> None:
    index(made)
    assert ask(made, "car", index_min_boxes=20).ranking == "ranked exactly"


def test_looks_of_a_filtered_box_count_for_the_other_boxes_of_its_track(made: Workspace) -> None:
    """The vector of the looks of track 5 bears the number of its box at 0 s."""
    index(made)
    assert ("one", 2, 2) in keys(ask(made, "bus", filters=Filters(from_s=0.15), candidates=1))


def test_a_changed_drive_is_searched_exactly_and_none_is_missing(made: Workspace) -> None:
    index(made)
    put(made, "two", [Thing({"car": 3}), Thing({"fire truck": 9}, track=8)])
    put(made, "three", [Thing({"fire truck": 7})])
    found = ask(made, "fire truck")
    assert {("two", 0, 1), ("three", 0, 0), ("one", 1, 1)} <= set(keys(found))
    assert ("two", 0, 0) not in keys(found)
    assert found.ranking.endswith("ranked by the index, 3 exactly")
    made.shard("pool-features", "two").unlink()
    assert not [key for key in keys(ask(made, "fire truck")) if key[0] == "two"]


def test_what_is_fresh_is_not_made_again(made: Workspace) -> None:
    assert "1 groups made, 0 were fresh" in index(made)
    first = vectors(made).stat()
    assert "0 groups made, 1 were fresh" in index(made)
    assert vectors(made).stat().st_ino == first.st_ino
    put(made, "two", [Thing({"car": 3})])
    assert "1 groups made" in index(made)
    assert ask(made, "car").ranking == "11 ranked by the index"


def damaged(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 255
    path.write_bytes(content)


@pytest.mark.parametrize("damage", ["head", "cut", "foreign", "stamp", "negative", "version"])
def test_a_file_that_is_not_the_stamped_one_is_never_read(made: Workspace, damage: str) -> None:
    exact = keys(ask(made, "fire truck"))
    index(made)
    path = vectors(made)
    stamp = path.with_suffix(".json")
    values = json.loads(stamp.read_text())
    if damage == "head":
        damaged(path, 40)
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    elif damage == "foreign":
        path.write_bytes(bytes(values["size"]))
    else:
        values = {
            "stamp": [1, 2],
            "negative": {**values, "vectors": -1},
            "version": {**values, "version": 0},
        }[damage]
        stamp.write_text(json.dumps(values))
    found = ask(made, "fire truck")
    assert found.ranking == "ranked exactly"
    assert keys(found) == exact
    assert "1 groups made" in index(made)
    assert "by the index" in ask(made, "fire truck").ranking


def test_damage_of_codes_and_numbers_costs_hits_alone_and_is_mended(made: Workspace) -> None:
    index(made)
    path = vectors(made)
    content = bytearray(path.read_bytes())
    count = json.loads(path.with_suffix(".json").read_text())["vectors"]
    content[-8 * count :] = b"\xff" * (8 * count)
    path.write_bytes(content)
    ask(made, "fire truck")
    assert "1 groups made" in index(made)


def test_codes_of_a_file_are_the_features_in_eight_bits(made: Workspace, tmp_path: Path) -> None:
    """The numbers say the row among the boxes of the group, and 1 more for looks."""
    drives = list(open_index(open_store(made, None)).drives.values())[:2]
    path = tmp_path / "two.faiss"
    names = tuple((f"drive-{number}", "", len(objects)) for number, objects in enumerate(drives))
    stamp = write_vectors(path, build_vectors(drives, basis()), names)
    file = VectorFile.open(path, stamp)
    assert file is not None and read_stamp(path) == stamp
    codes, numbers = file.read(np.arange(len(file.size)))
    factors, summands = file.words(np.eye(DIM, dtype=np.float32))
    found = codes @ factors.T + summands
    pooled = np.concatenate([objects.pooled for objects in drives])
    looks = np.concatenate([objects.look_feature for objects in drives])
    row, is_look = numbers // 2, numbers % 2 == 1
    stored = np.where(is_look[:, None], looks[row], pooled[row])
    np.testing.assert_allclose(found, basis().compact(basis().dequantize(stored)), atol=0.01)
    assert sorted(row[~is_look]) == np.flatnonzero(np.concatenate([d.num_features for d in drives])).tolist()
    assert is_look.sum() == 2  # two tracks were looked at, one of them in two frames
    np.testing.assert_allclose(file.center[0], found[:, :].mean(axis=0), atol=0.01)


def test_lists_of_many_boxes_lead_to_the_best(tmp_path: Path) -> None:
    """Some thousand boxes in several lists, of which a part is read: the best tracks are among them."""
    kinds = ["car", "bus", "tree", "road", "building"]
    many = [Thing({kinds[number % 5]: 2}, track=number) for number in range(1500)]
    many[700] = Thing({"pedestrian": 3}, track=700)
    made = workspace(tmp_path, {"one": many, "two": many})
    index(made)
    store = open_store(made, None)
    opened = open_index(store)
    (file,) = open_vectors(store, opened.drives, opened.digests).files
    assert len(file.size) == 7 and file.size.sum() == 3000
    found = ask(made, "pedestrian", candidates=2)
    assert sorted(keys(found)) == [("one", 0, 700), ("two", 0, 700)]
    assert found.ranking == "3000 ranked by the index"


def sizes(groups: dict[str, tuple[str, ...]]) -> Iterable[int]:
    return map(len, groups.values())


@pytest.mark.parametrize("drives", [0, 1, 64, 65, 5000])
def test_groups_hold_each_drive_once_and_are_of_a_sensible_size(drives: int) -> None:
    names = [f"drive-{number}" for number in range(drives)]
    groups = groups_of(reversed(names))
    assert sorted(name for group in groups.values() for name in group) == sorted(names)
    assert groups == groups_of(names)
    assert max(sizes(groups), default=0) <= 64
    assert len(groups) <= max(drives / 20, 2)


def test_another_drive_changes_one_group_or_splits_it() -> None:
    names = [f"drive-{number}" for number in range(1000)]
    before = groups_of(names)
    for number in range(1000, 1100):
        after = groups_of([*names, f"drive-{number}"])
        assert len(set(before) - set(after)) <= 1
        assert sum(before.get(group) != drives for group, drives in after.items()) <= 2 + 62


def test_a_group_that_splits_leaves_no_files_behind(made: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    index(made)
    for number in range(66):
        put(made, f"more-{number}", [Thing({"car": 2})] if number else [Thing({"fire truck": 2})])
    assert "ranked by the index, 66 exactly" in ask(made, "fire truck").ranking  # the old file serves
    index(made)
    names = sorted(path.name for path in (made.out / "query" / "index").iterdir() if path.name[0] != ".")
    groups = groups_of([*DRIVES, *(f"more-{number}" for number in range(66))])
    assert names == sorted(f"labels-{group}.{end}" for group in groups for end in ("arrow", "faiss", "json"))
    assert ("more-0", 0, 0) in keys(ask(made, "fire truck"))


def test_the_command_makes_the_files_and_a_query_says_that_it_used_them(tmp_path: Path) -> None:
    made = workspace(tmp_path, DRIVES, frames=3)
    done = upvl(tmp_path, "index")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("12 labels of 3 drives: 1 groups made, 0 were fresh; ")
    settings = made.stages / "query.toml"
    settings.write_text(settings.read_text().replace("index_min_boxes = 2_000_000", "index_min_boxes = 1"))
    done = upvl(tmp_path, "query", "fire truck", "--search", "--no-sheet")
    assert done.stdout.splitlines()[-2].endswith("; 12 ranked by the index")
    for path in (tmp_path / "out" / "query" / "index").glob("*.faiss"):
        path.unlink()
    done = upvl(tmp_path, "query", "fire truck", "--search", "--no-sheet")
    assert done.stdout.splitlines()[-2].endswith("; ranked exactly")
