"""Freshness by arrays gives the answer of `runner.state` for each shard, whatever happened to the workspace."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conditions import by_arrays, one_by_one, run
from scaled_numbers import add_drive, make, workspace_of, write_raw

from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.entries import stamp_parts
from upvl_cli.pipeline.catalog.tasks import fresh_segments, next_tasks
from upvl_cli.pipeline.runner import make_shard, state

DRIVES = 4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    workspace = make(folder, DRIVES)
    run(workspace)
    by_arrays(workspace)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "w", copy_function=shutil.copy2)
    write_raw(tmp_path / "w")
    by_arrays(workspace_of(tmp_path / "w"))  # the copies have other inodes: they are read once more
    return tmp_path / "w"


def shard(folder: Path, stage: str = "scale", segment: str = "d1") -> Path:
    return folder / "out" / stage / f"{segment}.parquet"


def replace_value(folder: Path, stage: str, text: str) -> None:
    (folder / "stages" / f"{stage}.toml").write_text(text)


def of_equal_size(folder: Path) -> None:
    """A shard of another value, with size and date of the first."""
    path = shard(folder)
    before = path.stat()
    changed = path.read_bytes().replace(b'"factor": 2.0', b'"factor": 5.0')
    path.write_bytes(changed)
    os.utime(path, ns=(before.st_mtime_ns, before.st_mtime_ns))
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)


def moved_into_place(folder: Path) -> None:
    """A shard of another drive, moved over this one."""
    shutil.copy2(shard(folder, segment="d2"), shard(folder).with_name("new"))
    shard(folder).with_name("new").replace(shard(folder))


def remade(folder: Path) -> None:
    """The first stage of one drive made again from another content."""
    (folder / "drives" / "d1" / "0.txt").write_text("7.5")
    workspace = workspace_of(folder)
    stage = workspace.pipeline.by_name["scale"]
    make_shard(workspace, stage, "d1", workspace.settings(stage), int)


def cut(path: Path, keep: int) -> None:
    path.write_bytes(path.read_bytes()[:keep])


def with_words(folder: Path) -> None:
    (folder / "words").mkdir(exist_ok=True)
    (folder / "words" / "d2.txt").write_text("words")
    replace_value(folder, "scale", f'factor = 2.0\nwords = "{folder / "words"}"\n')


def replaced_by_a_folder(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.mkdir()


DAMAGE: dict[str, Callable[[Path], object]] = {
    "nothing": lambda folder: None,
    "a value": lambda folder: replace_value(folder, "scale", 'factor = 2.5\nwords = ""\n'),
    "a comment": lambda folder: replace_value(folder, "scale", '# same\nfactor = 2.0\nwords = ""\n'),
    "other drives of the total": lambda folder: replace_value(folder, "total", 'drives = ["d[01]"]\n'),
    "a file of a drive changed": lambda folder: (folder / "drives/d2/0.txt").write_text("9.0"),
    "a file of a drive touched": lambda folder: os.utime(folder / "drives/d2/0.txt"),
    "a file more in a drive": lambda folder: (folder / "drives/d0/2.txt").write_text("1.0"),
    "a drive without files": lambda folder: shutil.rmtree(folder / "drives/d3", ignore_errors=True),
    "a drive that cannot be read": lambda folder: (
        shutil.rmtree(folder / "drives/d3", ignore_errors=True),
        (folder / "drives/d3").write_text(""),
    ),
    "a drive more": lambda folder: (
        shutil.rmtree(folder / "drives/d9", ignore_errors=True),
        add_drive(folder, "d9"),
    ),
    "fewer drives": lambda folder: write_raw(folder, segments='["d2", "d0"]'),
    "all drives": lambda folder: write_raw(folder),
    "files of settings": with_words,
    "a shard deleted": lambda folder: shard(folder).unlink(missing_ok=True),
    "a shard of the middle deleted": lambda folder: shard(folder, "double").unlink(missing_ok=True),
    "a shard cut": lambda folder: cut(shard(folder, segment="d0"), -1),
    "a shard emptied": lambda folder: cut(shard(folder, segment="d0"), 0),
    "a shard of nine bytes": lambda folder: cut(shard(folder, segment="d2"), 9),
    "the shard of all deleted": lambda folder: shard(folder, "total", "all").unlink(missing_ok=True),
    "the shard of all cut": lambda folder: cut(shard(folder, "total", "all"), 100),
    "another of equal size and date": of_equal_size,
    "that of another drive": moved_into_place,
    "remade from another content": remade,
    "touched": lambda folder: os.utime(shard(folder)),
    "no catalogue": lambda folder: shutil.rmtree(folder / "out/catalog", ignore_errors=True),
    "a catalogue that is cut": lambda folder: cut(folder / "out/catalog/scale.parquet", 200),
    "a catalogue of something else": lambda folder: pq.write_table(
        pa.table({"segment": ["d0"], "version": [1.5]}), folder / "out/catalog/scale.parquet"
    ),
    "made again": lambda folder: run(workspace_of(folder)),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGE)
def test_one_damage(folder: Path, name: str) -> None:
    DAMAGE[name](folder)
    expected = one_by_one(workspace_of(folder))
    assert by_arrays(workspace_of(folder)) == expected
    assert by_arrays(workspace_of(folder)) == expected, "with the catalogue that the first one wrote"


def test_each_damage_shows(folder: Path) -> None:
    """The comparison is worth something: these change the answer, and the others do not."""
    before = by_arrays(workspace_of(folder))
    assert set(before.values()) == {"fresh"}
    of_equal_size(folder)
    after = by_arrays(workspace_of(folder))
    assert after["scale", "d1"] == "stale"
    assert after["scale", "d0"] == "fresh"
    assert after["share", "d0"] == "stale"  # through the total


@pytest.mark.parametrize("seed", range(12))
def test_any_sequence_of_damage(folder: Path, seed: int) -> None:
    rng = random.Random(seed)
    done = []
    for _ in range(8):
        name = rng.choice(list(DAMAGE))
        done.append(name)
        try:
            DAMAGE[name](folder)
        except (OSError, UpvlError, AssertionError):  # on top of another damage it cannot be done
            continue
        preset, version = rng.choice([("", 1), ("", 1), ("large", 1), ("", 2)])
        expected = one_by_one(workspace_of(folder, preset, version))
        assert by_arrays(workspace_of(folder, preset, version)) == expected, done


def test_a_file_that_the_settings_name_counts_for_its_drive(folder: Path) -> None:
    with_words(folder)
    run(workspace_of(folder))
    assert set(by_arrays(workspace_of(folder)).values()) == {"fresh"}
    (folder / "words" / "d2.txt").write_text("other words")
    found = by_arrays(workspace_of(folder))
    assert found == one_by_one(workspace_of(folder))
    assert (found["scale", "d2"], found["scale", "d1"]) == ("stale", "fresh")


def test_a_folder_in_place_of_a_shard_is_a_missing_one(folder: Path) -> None:
    replaced_by_a_folder(shard(folder))
    assert by_arrays(workspace_of(folder)) == one_by_one(workspace_of(folder))


def test_fresh_shards_are_not_opened_again(folder: Path) -> None:
    opened: list[int] = []
    by_arrays(workspace_of(folder), tick=lambda: opened.append(1))
    assert not opened
    os.utime(shard(folder))
    by_arrays(workspace_of(folder), tick=lambda: opened.append(1))
    assert len(opened) == 1
    shutil.rmtree(folder / "out" / "catalog")
    by_arrays(workspace_of(folder), tick=lambda: opened.append(1))
    assert len(opened) == 1 + 3 * DRIVES


def test_the_catalogue_alone_says_what_it_was_when_it_was_written(folder: Path) -> None:
    before = by_arrays(workspace_of(folder))
    shard(folder).unlink()
    assert by_arrays(workspace_of(folder), lists=False) == before
    after = by_arrays(workspace_of(folder))
    assert after["scale", "d1"] == "missing"
    assert by_arrays(workspace_of(folder), lists=False) == after, "written anew, as a shard is gone"
    replace_value(folder, "double", "# nothing\n")
    replace_value(folder, "scale", 'factor = 2.5\nwords = ""\n')
    assert by_arrays(workspace_of(folder), lists=False) == one_by_one(workspace_of(folder)), "settings count"
    shutil.rmtree(folder / "out" / "catalog")
    assert by_arrays(workspace_of(folder), lists=False) == one_by_one(workspace_of(folder)), (
        "without one it lists"
    )


def test_few_new_shards_are_not_written_down(folder: Path) -> None:
    shutil.rmtree(folder / "out" / "catalog")
    by_arrays(workspace_of(folder), least_new=DRIVES + 1)
    assert not (folder / "out" / "catalog").exists()


def test_parts_of_several_processes_count_and_are_merged(folder: Path) -> None:
    shutil.rmtree(folder / "out" / "catalog")
    for part, segments in (("1-of-2", ["d0", "d1"]), ("2-of-2", ["d2", "d3"])):
        workspace = workspace_of(folder)
        reading = Reading(part=part, least_new=1)
        stage = workspace.pipeline.by_name["double"]
        assert fresh_segments(workspace, [stage], segments, reading=reading) == set(segments)
    catalog = folder / "out" / "catalog"
    assert sorted(path.name for path in (catalog / "double").iterdir()) == [
        "1-of-2.parquet",
        "2-of-2.parquet",
    ]
    opened: list[int] = []
    by_arrays(workspace_of(folder), tick=lambda: opened.append(1))
    assert len(opened) == DRIVES  # those of `share` alone
    os.utime(shard(folder, "double"))
    by_arrays(workspace_of(folder))
    assert not list((catalog / "double").iterdir())
    assert pq.read_table(catalog / "double.parquet").num_rows == DRIVES


def test_drives_that_never_change_are_not_opened(folder: Path) -> None:
    write_raw(folder, immutable="true")
    (folder / "drives/d2/0.txt").write_text("9.0")
    workspace = workspace_of(folder)
    assert set(by_arrays(workspace).values()) == {"fresh"}
    assert workspace.dataset.opened == 0  # type: ignore[attr-defined]
    assert state(workspace_of(folder), workspace.pipeline.stages[0], "d2")[0] == "stale"


def test_drives_whose_shards_disagree_are_opened_all_the_same(folder: Path) -> None:
    remade(folder)  # `scale` of another content than `double`
    write_raw(folder, immutable="true")
    workspace = workspace_of(folder)
    assert by_arrays(workspace) == one_by_one(workspace_of(folder))
    assert workspace.dataset.opened == 1  # type: ignore[attr-defined]


def test_the_setting_of_unchanging_drives_is_no_part_of_a_stamp(folder: Path) -> None:
    stage = workspace_of(folder).pipeline.stages[0]
    before = workspace_of(folder).shard_stamp(stage, "d0")
    write_raw(folder, immutable="true")
    assert workspace_of(folder).shard_stamp(stage, "d0") == before


def test_the_next_tasks_can_be_made_now(tmp_path: Path) -> None:
    """Making what is given, again and again, makes everything, each shard once, and never wants an input."""
    workspace = make(tmp_path, 3)
    stages = workspace.pipeline.stages
    done: list[tuple[str, str]] = []
    while tasks := next_tasks(workspace, stages, 2):
        for name, segment in tasks:
            stage = workspace.pipeline.by_name[name]
            assert not make_shard(workspace, stage, segment, workspace.settings(stage), int).fresh
        done += tasks
        workspace = workspace_of(tmp_path)
    assert sorted(done) == sorted(one_by_one(workspace))
    assert fresh_segments(workspace, stages, ["d0", "d2"]) == {"d0", "d2"}


def test_the_next_tasks_are_of_the_stages_that_are_asked_for(folder: Path) -> None:
    shard(folder).unlink()
    shard(folder, "double", "d3").unlink()
    workspace = workspace_of(folder)
    by_name = workspace.pipeline.by_name
    assert next_tasks(workspace, workspace.pipeline.stages, 10) == [("scale", "d1"), ("double", "d3")]
    assert next_tasks(workspace, [by_name["double"]], 10) == [("double", "d3")]
    assert next_tasks(workspace, workspace.pipeline.stages, 1) == [("scale", "d1")]
    assert fresh_segments(workspace, [by_name["double"]], ["d0", "d1", "d3"]) == {"d0"}


def test_a_stamp_in_another_text_equals_none() -> None:
    text = '{"inputs": {}, "raw": {"content": "x"}}'
    assert stamp_parts(text).raw == "x"
    for other in (text.replace(": ", ":"), '{"inputs": {}}', "[]", "1", '{"inputs": 1, "raw": 2}'):
        with pytest.raises(ValueError, match="stamp|text"):
            stamp_parts(other)


def test_values_of_a_run_count(folder: Path) -> None:
    workspace = workspace_of(folder)
    stage = workspace.pipeline.stages[0]
    other = {"scale": workspace.with_values(stage, {"factor": 4.0})}
    assert fresh_segments(workspace, [stage], ["d0"]) == {"d0"}
    assert fresh_segments(workspace, [stage], ["d0"], other) == set()
