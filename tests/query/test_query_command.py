"""The commands whole: what they print and write, and their one line where something is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from stored import Thing, workspace

from command import fails, upvl
from upvl_cli.query.report import slug


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of a drive that there is, street-0, and of one that there is not."""
    made = tmp_path_factory.mktemp("asked")
    street = [
        Thing({"fire truck": 19, "bus": 1}, x_m=12, speed_mps=5, track=7, frames=(0, 1)),
        Thing({"car": 9}, x_m=20),
        Thing({"pedestrian": 5}, x_m=8),
    ]
    workspace(made, {"street-0": street, "gone": [Thing({"fire truck": 8}, x_m=25)]}, frames=2)
    return made


def test_a_query_prints_a_line_an_object_and_writes_each_box(folder: Path) -> None:
    done = upvl(folder, "query", "fire truck")
    assert done.returncode == 0, done.stderr
    heading, first, second, summary, table, sheet = done.stdout.splitlines()
    assert heading.split()[:3] == ["word", "score", "votes"]
    assert " ".join(first.split()) == "fire truck 1.00 100% gone - 1 0 0.0 25.0 0.0"
    assert " ".join(second.split()) == "fire truck 0.95 95% street-0 7 2 0 0.0 12.0 5.0"
    assert summary == "5 labels: 3 hits of 2 objects, 2 other words"
    assert (table, sheet) == ("out/query/fire-truck.parquet", "out/query/fire-truck.png")
    rows = pq.read_table(folder / table).to_pylist()
    assert [(row["segment"], row["frame"], row["box"]) for row in rows] == [
        ("gone", 0, 0), ("street-0", 0, 0), ("street-0", 1, 0),
    ]  # fmt: skip
    assert rows[1]["class"] == rows[1]["word"] == "fire truck"
    box = ("center_x_m", "center_y_m", "center_z_m", "length_m", "width_m", "height_m", "heading_rad")
    np.testing.assert_allclose([rows[1][name] for name in box], [12, 0, 0, 4, 2, 1.5, 0])
    velocity = ("velocity_x_mps", "velocity_y_mps", "velocity_z_mps")
    np.testing.assert_allclose([rows[1][name] for name in velocity], [5, 0, 0])
    numbers = ("score", "share", "confidence", "track_id", "num_features", "time_s")
    np.testing.assert_allclose([rows[2][name] for name in numbers], [0.95, 0.95, 1, 7, 20, 0.1])


def test_words_that_are_one_to_the_model_are_named(folder: Path) -> None:
    done = upvl(folder, "query", "red truck", "--no-sheet")
    assert 'mini cannot distinguish "red truck" from "truck": ' in done.stdout


def test_the_sheet_shows_points_and_pictures_where_they_are(folder: Path) -> None:
    done = upvl(folder, "query", "fire truck")
    image = np.asarray(Image.open(folder / done.stdout.splitlines()[-1]))
    gone, street = np.split(image, 2, axis=1)
    assert gone.shape == street.shape
    right = slice(gone.shape[1] - 400, None)
    assert len(np.unique(street[:, right].reshape(-1, 3), axis=0)) > 500  # a picture
    assert len(np.unique(gone[30:, right].reshape(-1, 3), axis=0)) == 1  # none


def test_nothing_found_is_no_error(folder: Path) -> None:
    done = upvl(folder, "query", "zebra crossing", "--moving", "--no-sheet")
    assert done.returncode == 0
    assert done.stdout.splitlines()[0] == "5 labels: 0 hits of 0 objects, 3 filtered out, 2 other words"
    assert pq.read_table(folder / "out/query/zebra-crossing.parquet").num_rows == 0


def test_classes_of_a_file(folder: Path) -> None:
    (folder / "my classes.toml").write_text(
        '[people]\nwords = ["pedestrian", "person"]\nnegatives = ["car", "bus"]\n'
    )
    done = upvl(folder, "query", "--classes", "my classes.toml", "--no-sheet", "--search", "--by", "mean")
    assert done.stdout.splitlines()[1].split()[:2] == ["people", "pedestrian"]
    assert (folder / "out/query/my-classes.parquet").is_file()


def test_words_are_compared(folder: Path) -> None:
    done = upvl(folder, "words", "fire truck, car")
    lines = done.stdout.splitlines()
    assert lines[0].split()[:2] == ["word", "boxes"]
    assert lines[1].split()[:3] == ["fire", "truck", "3"]
    assert "truck 3" in lines[1]
    assert lines[-3].startswith("5 labels with features")
    assert lines[-2].startswith('"fire truck" to mini: ')
    assert lines[-1].startswith('"car" to mini: car 0.9')


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["query", "fire trcuk"], 'no such word: "trcuk"; did you mean "truck"? (--anyway asks regardless)'),
        (["words", "fire trcuk, car"], 'did you mean "truck"'),
        (["query", "xqzzt"], 'no such word: "xqzzt" (--anyway'),
        (["query", ""], "an empty phrase is asked for"),
        (["query"], "nothing is asked for"),
        (["query", "\u200b"], "mini has no vector for"),
        (["query", "car", "--on", "lables"], "--on lables: expected labels or detections"),
        (["query", "car", "--by", "luck"], "--by luck: expected vote or mean"),
        (["query", "car", "--on", "detections"], "no detections with features in out; run: upvl train, then"),
        (["query", "car", "-s", "stret-0"], "unknown segment 'stret-0'; did you mean 'street-0'"),
        (["query", "car", "--top", "0"], "top = 0 must be >= 1"),
        (["query", "--classes", "none.toml"], "none.toml is missing; expected a file of classes"),
        (["query", "car", "--classes", "none.toml"], "both phrases and --classes are given"),
    ],
)
def test_what_cannot_be_asked_is_one_line(folder: Path, arguments: list[str], message: str) -> None:
    assert message in fails(folder, *arguments)


def test_a_workspace_without_labels_says_what_to_run(tmp_path: Path) -> None:
    workspace(tmp_path, {})
    assert "there are no labels with features in out; run: upvl autolabel" in fails(tmp_path, "query", "car")


def test_a_drive_without_labels_says_what_to_run(tmp_path: Path) -> None:
    workspace(tmp_path, {"other": []})
    said = fails(tmp_path, "query", "car", "--segment", "street-0")
    assert "street-0 has no labels with features; run: upvl pool-features --segment street-0" in said


def test_a_damaged_shard_is_named(tmp_path: Path) -> None:
    made = workspace(tmp_path, {"one": [Thing({"car": 3})]})
    made.shard("pool-features", "one").write_bytes(b"PAR1 no more")
    assert "out/pool-features/one.parquet is damaged" in fails(tmp_path, "query", "car")


def test_a_query_loads_no_network(folder: Path) -> None:
    """The modules that a query imports, told by Python itself."""
    done = upvl(folder, "query", "car", "--no-sheet", PYTHONPROFILEIMPORTTIME="1")
    loaded = {line.rsplit("|")[-1].strip() for line in done.stderr.splitlines()}
    assert "upvl_cli.query.find" in loaded
    assert not loaded & {"torch", "PIL.Image", "sklearn", "scipy"}


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("fire truck", "fire-truck"),
        ("../../etc/passwd", "etc-passwd-"),
        ("日本", ""),
        ("a" * 500, "a" * 60 + "-"),
        ("..", ""),
    ],
)
def test_file_names_stay_in_their_folder(text: str, name: str) -> None:
    made = slug(text)
    assert made.startswith(name)
    assert set(made) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")
    assert 0 < len(made) <= 69
    assert slug("fire-truck") != slug("fire truck")
