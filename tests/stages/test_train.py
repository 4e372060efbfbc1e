"""`pool-features`, `train` and `detect` whole, on the street: a tiny network, a few steps."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from command import UPVL, fails, make_workspace, of_streets, set_value, upvl
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.evaluation.gather import gather
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace

SEGMENT = "street-0"
# One process runs them all: what they share is made once.
pytestmark = pytest.mark.xdist_group("train")
TINY = {
    **of_streets(1, frames=6),
    "extract-vl__images": '"all"', "pca__images": "2", "detect__min_score": "0.0", "detect__max_boxes": "20",
    "train__steps": "6", "train__check_steps": "2", "train__width": "8", "train__pillar_m": "0.8",
    "train__pasted_objects": "2", "train__batch": "2",
}  # fmt: skip


@pytest.fixture(scope="session")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with labels of what moves, and their features."""
    folder = make_workspace(tmp_path_factory.mktemp("train"), **TINY)
    done = upvl(folder, "autolabel", "--moving-only")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def trained(labelled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, with a detector and what it finds."""
    folder = tmp_path_factory.mktemp("trained") / "w"
    shutil.copytree(labelled, folder, copy_function=shutil.copy2)
    for command in ("train", "detect"):
        done = upvl(folder, command)
        assert done.returncode == 0, done.stderr
    return folder


def copied(source: Path, folder: Path) -> Path:
    """A workspace to change at will."""
    return Path(shutil.copytree(source, folder / "copy", copy_function=shutil.copy2))


def table(folder: Path, stage: str) -> Table:
    return Table(
        folder
        / "out"
        / stage
        / f"{WHOLE_DATASET if PIPELINE.by_name[stage].scope == 'dataset' else SEGMENT}.parquet",
        PIPELINE.by_name[stage].row,
    )


def test_a_label_has_the_features_of_its_points(labelled: Path) -> None:
    summaries, labels, features, masks = (
        table(labelled, name) for name in ("pool-features", "nms", "extract-vl", "mask")
    )
    drive = Workspace(PIPELINE, labelled / "stages", labelled / "out").drive(SEGMENT)
    points = 0
    for frame in (0, 5):
        row, of_points = summaries[frame], features[frame]
        np.testing.assert_array_equal(row.boxes.to_rows(), labels[frame].boxes.to_rows())
        xyz = drive.points(frame).xyz_ego_m[of_points.state == SEEN]
        is_object = masks[frame].background[of_points.state == SEEN] == 0
        inside = points_inside(xyz, row.boxes, margin_m=0.0) & is_object
        for box in range(len(row.boxes)):
            of_box = row.point_feature.values[row.point_feature.owner == box]
            np.testing.assert_array_equal(of_box, of_points.feature[inside[box]])
            assert row.pooled[box].any() == inside[box].any()
        points += len(row.point_feature.values)
    assert points > 50


def test_labels_in_place_of_detections(labelled: Path) -> None:
    assert upvl(labelled, "detect", "--on", "labels").returncode == 0
    assert not (labelled / "out" / "detect").exists()
    assert "--on 'boxes': expected detector or labels" in fails(labelled, "detect", "--on", "boxes")
    assert "takes no settings" in fails(labelled, "detect", "--on", "labels", "--decode-min-score", "0.5")
    assert "which is missing (not made); run: upvl train" in fails(labelled, "detect")
    assert "out/train/all.parquet has not been made" in fails(labelled, "curves")


def test_what_is_learned_and_what_is_kept(trained: Path) -> None:
    (row,) = table(trained, "train")
    assert len(row.total) == len(row.learning_rate) == 6
    assert row.check_step.tolist() == [2, 4, 6]
    assert row.has_distillation_head and (row.distillation > 0).all()
    np.testing.assert_allclose(
        row.total, row.objectness + row.box + row.heading + row.distillation, rtol=1e-5
    )
    assert sum(weight.numel() for weight in row.detector.parameters()) > 1000
    assert not (trained / "out" / "train" / "checkpoint.safetensors").exists()
    assert upvl(trained, "train").stdout == ""
    assert upvl(trained, "curves").stdout == "out/train/curves.png\n"
    assert (trained / "out/train/curves.png").read_bytes().startswith(b"\x89PNG")


def test_scores_by_name_and_by_drive(trained: Path) -> None:
    for what in ("labels", "detections"):
        done = upvl(trained, "eval", "--what", what, "--by-class", "--all-motion", "--segment", SEGMENT)
        assert done.returncode == 0, done.stderr
        assert "by name, level 2  vehicles    VRU    mAP" in done.stdout
    assert "unknown segment 'elsewhere'" in fails(trained, "eval", "--segment", "elsewhere")


def test_detections_have_tracks_features_and_scores(trained: Path) -> None:
    rows = list(table(trained, "detect"))
    assert [row.frame for row in rows] == list(range(6))
    for row in rows:
        assert 0 < len(row.boxes) <= 20
        assert (row.velocity_mps[row.track_id < 0] == 0).all()
        assert len(row.point_feature.values) == row.num_points.sum()
        np.testing.assert_array_equal(row.point_feature.count, row.num_points)
    track, size_m = (
        np.concatenate([getattr(row, name) for row in rows]) for name in ("track_id", "size_lwh_m")
    )
    assert len(np.unique(track)) > 3
    for number in np.unique(track[track >= 0]):
        assert np.ptp(size_m[track == number], axis=0).max() == 0


def test_each_frame_can_speak_for_itself(trained: Path, tmp_path: Path) -> None:
    folder = copied(trained, tmp_path)
    set_value(folder, "detect", "enabled", "false")
    assert upvl(folder, "detect").returncode == 0
    rows = list(table(folder, "detect"))
    assert all((np.diff(row.score) <= 0).all() for row in rows)
    xyz = Workspace(PIPELINE, folder / "stages", folder / "out").drive(SEGMENT).points(3).xyz_ego_m
    # Points on a face of a box can fall either way: heights above the road are rounded.
    inside = points_inside(xyz, rows[3].boxes, margin_m=0.0).sum(axis=1)
    np.testing.assert_allclose(inside, rows[3].num_points, atol=2)


def test_detections_are_scored_and_named(trained: Path) -> None:
    done = upvl(trained, "eval", "--what", "detections", "--class-agnostic", "--all-motion")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("detections, all-motion, class-agnostic")
    material = gather(
        Workspace(PIPELINE, trained / "stages", trained / "out"), "detect", region=None, named=True
    )
    assert material.has_class
    assert set(np.unique(material.predictions.type)) <= {0, 1, 2, 4}


@pytest.mark.slow
def test_other_drives_and_batches_than_there_are(labelled: Path, tmp_path: Path) -> None:
    folder = copied(labelled, tmp_path)
    set_value(folder, "train", "drives", '["val-*"]')
    assert "train: no drive has a name like val-*; see: upvl segments" in fails(folder, "train")
    set_value(folder, "train", "drives", '["*"]')
    set_value(folder, "train", "x_max_m", "-50.0")
    assert "grid x_m goes from -50.0 to -50.0, expected the smaller number first" in fails(folder, "train")


@pytest.mark.slow
def test_a_killed_training_ends_with_the_same_bytes(trained: Path, labelled: Path, tmp_path: Path) -> None:
    folder = copied(labelled, tmp_path)
    checkpoint = folder / "out" / "train" / "checkpoint.safetensors"
    process = subprocess.Popen([UPVL, "train"], cwd=folder, start_new_session=True)
    while not checkpoint.exists() and process.poll() is None:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert checkpoint.exists()
    assert not (folder / "out" / "train" / "all.parquet").exists()
    assert upvl(folder, "train").returncode == 0
    shard = Path("out", "train", "all.parquet")
    assert (folder / shard).read_bytes() == (trained / shard).read_bytes()
    assert not checkpoint.exists()


@pytest.mark.slow
def test_two_processes_write_one_shard_with_the_same_curve(labelled: Path, tmp_path: Path) -> None:
    folder = copied(labelled, tmp_path)
    # Two halves of a batch are rounded otherwise than the whole, and each step of AdamW multiplies that:
    # in float64 the curves are the same to 1e-14, here small steps in full precision keep it near 1e-5 (docs/log.md).
    set_value(folder, "train", "precision", '"full"')
    set_value(folder, "train", "learning_rate", "0.0001")
    assert upvl(folder, "train").returncode == 0
    (one,) = table(folder, "train")
    shutil.rmtree(folder / "out" / "train")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    done = subprocess.run(
        [*command, "-m", "upvl_cli", "train"], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("made stage=train") == 1
    (two,) = table(folder, "train")
    assert two.total[0] == pytest.approx(one.total[0], rel=1e-5)  # before any step
    for name in ("total", "box", "distillation", "check_total"):
        np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-4)


@pytest.mark.slow
def test_a_preset_of_training_stands_beside_that_of_the_labels(labelled: Path, tmp_path: Path) -> None:
    folder = copied(labelled, tmp_path)
    (folder / "stages" / "presets" / "moving-only" / "mask.toml").write_text("min_speed_mps = 1.0\n")
    (folder / "stages" / "presets" / "quick").mkdir()
    (folder / "stages" / "presets" / "quick" / "train.toml").write_text("steps = 1\nheld_out = 0.0\n")
    assert upvl(folder, "train", "--preset", "quick").returncode == 0
    assert (folder / "out" / "preset").read_text() == "moving-only+quick\n"
    (row,) = table(folder, "train")
    assert len(row.total) == 1 and len(row.check_step) == 0
    assert "made" not in upvl(folder, "autolabel", "--moving-only").stdout
    assert (folder / "out" / "preset").read_text() == "quick+moving-only\n"
    assert upvl(folder, "train").stdout == ""
    assert "presets/slow is missing" in fails(folder, "train", "--preset", "slow")
    (folder / "stages" / "presets" / "quick" / "train.toml").write_text("steps = 0\n")
    assert "presets/quick/train.toml: steps = 0 must be >= 1" in fails(folder, "train")
