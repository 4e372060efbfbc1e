"""Features from pictures to labels: the commands, whole, on the quick street."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command import fails, make_workspace, set_value, upvl
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.perception.visual.views import NO_VIEW, SEEN
from upvl_cli.pipeline.provenance import is_of_settings
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.vlm import MODELS

SEGMENT = "street-0"
# One process runs them all: what they share is made once.
pytestmark = pytest.mark.xdist_group("extract_vl")


@pytest.fixture(scope="session")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with labels in all motion states, made once."""
    folder = tmp_path_factory.mktemp("vision")
    make_workspace(folder)
    shutil.rmtree(folder / "stages")
    shutil.copytree(Path(__file__).parents[2] / "stages", folder / "stages")
    set_value(folder, "raw", "dataset", '"streets"')
    set_value(folder, "raw", "root", '"1x8"')
    set_value(folder, "pca", "images", "6")
    done = upvl(folder, "autolabel", "--all-motion")
    assert done.returncode == 0, done.stderr
    return folder


def table(folder: Path, stage: str) -> Table:
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    return Table(
        workspace.shard(stage, WHOLE_DATASET if PIPELINE.by_name[stage].is_of_dataset else SEGMENT),
        PIPELINE.by_name[stage].row,
    )


def test_every_point_that_the_camera_sees_has_a_feature(labelled: Path) -> None:
    for row in table(labelled, "extract-vl"):
        assert len(row.feature) == (row.state == SEEN).sum() > 1000
        assert ((row.camera >= 0) == (row.state == SEEN)).all()
        assert (row.state == NO_VIEW).any()


def test_all_is_fresh_when_it_is_asked_for_again(labelled: Path) -> None:
    done = upvl(labelled, "autolabel", "--all-motion")
    assert "made stage" not in done.stdout
    # Nothing loads the network when the shard is fresh.
    assert upvl(labelled, "extract-vl", PYTHONPROFILEIMPORTTIME="1").stderr.count("torch") == 0


@pytest.mark.slow
def test_the_mode_is_remembered_and_left_again(labelled: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(labelled, tmp_path / "work"))
    done = upvl(folder, "autolabel", "--moving-only")
    assert done.returncode == 0
    assert (folder / "out" / "preset").read_text() == "moving-only\n"
    lines = [line.split() for line in upvl(folder, "status").stdout.splitlines()[1:]]
    assert {line[0] for line in lines if line[1] == "1"} == {
        stage.name for stage in PIPELINE.labelling_stages
    }
    moving = sum(len(row.track_id) for row in table(folder, "nms"))
    assert moving < sum(len(row.track_id) for row in table(labelled, "nms"))
    made = upvl(folder, "autolabel", "--all-motion").stdout
    assert "made stage=mask" in made
    assert "made stage=flow" not in made


def test_another_model_is_another_shard(labelled: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(labelled, tmp_path / "work"))
    set_value(folder, "vlm", "model", '"min"')
    assert "unknown model 'min'; did you mean 'mini'" in fails(folder, "extract-vl")
    set_value(folder, "vlm", "model", '"clip:/nowhere/at-all"')
    assert "/nowhere/at-all" in fails(folder, "extract-vl")


def test_other_code_of_a_model_makes_its_shards_stale(
    labelled: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def freshness(stage: str) -> tuple[str, str]:
        workspace = Workspace(PIPELINE, labelled / "stages", labelled / "out")
        return state(
            workspace,
            PIPELINE.by_name[stage],
            WHOLE_DATASET if PIPELINE.by_name[stage].is_of_dataset else SEGMENT,
        )

    assert freshness("extract-vl")[0] == freshness("ground")[0] == "fresh"
    monkeypatch.setitem(MODELS, "mini", replace(MODELS["mini"], version=99))
    assert freshness("pca")[0] == freshness("extract-vl")[0] == "stale"
    assert "vlm.version" in freshness("pca")[1]
    assert not is_of_settings(freshness("pca")[1])
    assert freshness("ground")[0] == "fresh"


def test_the_size_is_estimated(labelled: Path) -> None:
    said = upvl(labelled, "extract-vl", "--dry-run").stdout
    foretold = float(said.splitlines()[0].split()[1]) * 1e6
    true = (labelled / "out" / "extract-vl" / f"{SEGMENT}.parquet").stat().st_size
    assert foretold == pytest.approx(true, rel=0.1)


def test_words_can_be_drawn(labelled: Path) -> None:
    done = upvl(labelled, "draw", "--words", "car, tree, person")
    assert done.returncode == 0, done.stderr
    paths = [labelled / line for line in done.stdout.split()]
    assert len(paths) == 2
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert "has no word" in fails(labelled, "draw", "--words", " , ")


def test_the_threshold_can_be_found_without_labels(labelled: Path) -> None:
    done = upvl(labelled, "fit-background-threshold")
    assert done.returncode == 0, done.stderr
    assert "eps_bg = " in done.stdout
    assert (labelled / "out" / "fit-background-threshold" / "background.png").is_file()


def test_a_workspace_without_features_says_what_to_run(tmp_path: Path) -> None:
    folder = make_workspace(tmp_path / "work")
    assert "make extract-vl" in fails(folder, "draw", "--words", "car")
    assert "pca" in fails(folder, "fit-background-threshold")


def test_each_label_has_one_class_in_all_frames(labelled: Path) -> None:
    classes: dict[int, set[tuple[int, str]]] = {}
    classified = table(labelled, "classify")
    for row in table(labelled, "nms"):
        of_frame = classified[row.frame]
        assert set(row.track_id) == set(of_frame.track_id)
        for track, kind, word in zip(of_frame.track_id, of_frame.type, of_frame.word, strict=True):
            classes.setdefault(int(track), set()).add((int(kind), str(word)))
    assert classes
    assert all(len(found) == 1 for found in classes.values())
    assert np.isin([kind for ((kind, _),) in classes.values()], [0, 1, 2, 4]).all()
    settings = Workspace(PIPELINE, labelled / "stages", labelled / "out").settings(
        PIPELINE.by_name["classify"]
    )
    known = {*settings.words[1], *settings.kind_words[1], ""}
    assert {word for ((_, word),) in classes.values()} <= known


def test_labels_are_those_of_nms_with_their_class(labelled: Path) -> None:
    labels, boxes, classified = (table(labelled, stage) for stage in ("labels", "nms", "classify"))
    assert sum(len(row.track_id) for row in labels) > 0
    for row in labels:
        np.testing.assert_array_equal(row.track_id, boxes[row.frame].track_id)
        np.testing.assert_array_equal(row.center_m, boxes[row.frame].center_m)
        word = dict(zip(classified[row.frame].track_id, classified[row.frame].word, strict=True))
        assert [word[track] for track in row.track_id] == list(row.word)


def test_stages_that_are_made_once_have_one_shard(labelled: Path) -> None:
    for stage in PIPELINE.labelling_stages:
        if stage.is_of_dataset:
            assert [path.stem for path in (labelled / "out" / stage.name).glob("*.parquet")] == [
                WHOLE_DATASET
            ]
