"""Commands whole: what they print, what they refuse, how they exit."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

from command import ENVIRONMENT, ROOT, UPVL, fails, make_workspace, of_streets, set_value, upvl
from tiny_kitti import write_drive
from upvl_cli.cli import run
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.tables import Table, write
from upvl_cli.stages import STAGES

# One process runs them all: what they share is made once.
pytestmark = pytest.mark.xdist_group("cli")
# One street, so long that things are tracked in it, and no longer.
FRAMES = 8
SHORT = of_streets(1, frames=FRAMES)


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace in which the built-in drive has been labelled once."""
    folder = make_workspace(tmp_path_factory.mktemp("labelled"), **SHORT)
    done = upvl(folder, "autolabel", "--moving-only")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def copy(labelled: Path, tmp_path: Path) -> Path:
    """The same, to change at will."""
    shutil.copytree(labelled, tmp_path / "copy", copy_function=shutil.copy2)
    return tmp_path / "copy"


def made(done: subprocess.CompletedProcess[str]) -> list[str]:
    """The stages of which a run made a shard."""
    return [line.split()[1].split("=")[1] for line in done.stdout.splitlines() if line.startswith("made ")]


def test_help_names_every_stage_and_loads_nothing_heavy(tmp_path: Path) -> None:
    done = upvl(tmp_path, "--help")
    assert done.returncode == 0
    assert all(stage.name in done.stdout for stage in STAGES)
    code = "import sys, upvl_cli.cli; print([m for m in ('torch', 'numpy', 'pyarrow', 'scipy') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_help_of_a_stage_tells_meaning_unit_and_range(tmp_path: Path) -> None:
    text = " ".join(upvl(tmp_path, "mask", "--help").stdout.replace("│", " ").split())
    assert "lowest speed of a point that counts as moving: eps_sf of UP-VL (m/s, >= 0 and <= 200)" in text


def test_labels_and_summary(labelled: Path) -> None:
    done = upvl(labelled, "summary")
    assert done.returncode == 0
    assert done.stdout.startswith(f"street-0: {FRAMES} frames, ")
    assert "points moving" in done.stdout


def test_one_drive_of_two_is_labelled_and_told_of(tmp_path: Path) -> None:
    two = make_workspace(tmp_path, **of_streets(2, frames=2))
    assert "see: upvl segments" in fails(two, "summary", "--segment", "street-2")
    assert "run: make nms" in fails(two, "summary")
    done = upvl(two, "autolabel", "--moving-only", "--segment", "street-0")
    assert done.returncode == 0, done.stderr
    assert "\nstreet-0: 2 frames" in done.stdout
    assert "street-1" not in done.stdout
    assert "\nnot labelled: street-1\n" in upvl(two, "summary").stdout
    assert "out/nms/street-1.parquet has not been made" in fails(two, "summary", "--segment", "street-1")


def test_a_second_run_makes_nothing(copy: Path) -> None:
    assert made(upvl(copy, "autolabel", "--moving-only")) == []


def test_a_changed_value_remakes_its_stage_and_later(copy: Path) -> None:
    set_value(copy, "mask", "min_speed_mps", "1.5")
    assert made(upvl(copy, "autolabel", "--moving-only")) == [
        "mask",
        "propose",
        "track",
        "amodal",
        "nms",
        "looks",
        "match-boxes2d",
        "classify",
        "labels",
        "pool-features",
    ]


def test_a_comment_remakes_nothing(copy: Path) -> None:
    path = copy / "stages" / "flow.toml"
    path.write_text(path.read_text() + "# a thought\n")
    assert made(upvl(copy, "autolabel", "--moving-only")) == []


def test_a_stage_by_hand_wants_its_inputs_first(tmp_path: Path) -> None:
    folder = make_workspace(tmp_path)
    assert (
        "flow needs out/odometry/street-0.parquet, which is missing (not made); run: upvl odometry"
        in fails(folder, "flow")
    )


def test_a_stage_below_a_changed_one_is_refused(copy: Path) -> None:
    set_value(copy, "mask", "min_speed_mps", "1.5")
    message = fails(copy, "track")
    assert "out/propose/street-0.parquet, which is stale (mask.min_speed_mps 1.0 -> 1.5)" in message
    assert "; to keep it, write the values left of -> in stages" in message


def test_other_values_by_hand_do_not_get_into_the_same_folder(copy: Path) -> None:
    before = (copy / "out" / "mask" / "street-0.parquet").read_bytes()
    message = fails(copy, "mask", "--min-speed-mps", "2")
    assert "out holds mask with other values (mask.min_speed_mps 1.0 -> 2.0)" in message
    assert "cp -r stages stages2" in message
    assert (copy / "out" / "mask" / "street-0.parquet").read_bytes() == before


def test_status_tells_fresh_stale_and_missing(copy: Path) -> None:
    set_value(copy, "track", "min_boxes", "9")
    (copy / "out" / "nms" / "street-0.parquet").unlink()
    rows = {line.split()[0]: line.split()[1:4] for line in upvl(copy, "status").stdout.splitlines()}
    assert rows["flow"] == ["1", "0", "0"]
    assert rows["track"] == ["0", "1", "0"]
    assert rows["amodal"] == ["0", "1", "0"]
    assert rows["nms"] == ["0", "0", "1"]


def test_draw_writes_pictures_and_names_them(copy: Path) -> None:
    done = upvl(copy, "draw", "street-0", "--frame", "3")
    names = [Path(line).name for line in done.stdout.splitlines()]
    assert names == ["street-0-000003-above.png", "street-0-000003-front.png"]
    assert all((copy / line).read_bytes().startswith(b"\x89PNG") for line in done.stdout.splitlines())


def test_points_are_coloured_by_their_fused_class(copy: Path) -> None:
    assert "semantics" in fails(copy, "draw", "--semantics")
    assert made(upvl(copy, "semantics")) == ["semantics"]
    paths = upvl(copy, "draw", "--semantics", "--frame", "3").stdout.split()
    assert [Path(path).name for path in paths] == [
        "street-0-000003-semantics-above.png", "street-0-000003-semantics-front.png",
    ]  # fmt: skip
    assert all((copy / path).read_bytes().startswith(b"\x89PNG") for path in paths)
    assert "both --words and --semantics" in fails(copy, "draw", "--semantics", "--words", "car")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["draw", "--frame", "99"], "street-0 has no frame 99: it has 0 to 7"),
        (["draw", "street-9"], "unknown segment 'street-9'; did you mean 'street-0'?"),
        (["flow", "--segment", "../street-0"], "unknown segment '../street-0'"),
        (["autolabel"], "say which objects to label: upvl autolabel --moving-only"),
        (["init", "."], "stages exists already: choose another folder, nothing was changed"),
    ],
)
def test_what_cannot_be_done_is_one_line(labelled: Path, arguments: list[str], message: str) -> None:
    assert message in fails(labelled, *arguments)


def test_a_typo_is_answered_with_the_right_word(labelled: Path) -> None:
    assert "No such command 'autolable'. Did you mean 'autolabel'" in fails(labelled, "autolable")
    assert "No such option: --min-speed" in fails(labelled, "mask", "--min-speed", "2")
    assert "Invalid value for '--workers'" in fails(labelled, "flow", "--workers", "0")


def test_outside_a_workspace(tmp_path: Path) -> None:
    assert "stages/raw.toml is missing" in fails(tmp_path, "segments")


def test_segments(labelled: Path) -> None:
    assert upvl(labelled, "segments").stdout == "street-0\n"


def test_a_new_workspace_works(tmp_path: Path) -> None:
    done = upvl(tmp_path, "init", "mine")
    assert done.returncode == 0
    assert upvl(tmp_path / "mine", "segments").stdout == "train-000\n"
    set_value(tmp_path / "mine", "synthetic", "frames", "2")
    make = ["make", f"UPVL_COMMAND={UPVL}", "odometry"]
    assert subprocess.run(make, cwd=tmp_path / "mine", capture_output=True).returncode == 0
    assert (tmp_path / "mine" / "out" / "odometry" / "train-000.parquet").is_file()


def test_synth_draws_made_up_frames(tmp_path: Path, labelled: Path) -> None:
    made_up = make_workspace(tmp_path, raw__dataset='"synthetic"', synthetic__frames="2")
    done = upvl(made_up, "synth", "preview", "--frame", "1")
    assert done.stdout == "out/draw/train-000-000001-preview.png\n", done.stderr
    with Image.open(made_up / "out/draw/train-000-000001-preview.png") as picture:
        assert picture.width == 1600
    assert "train-000 has no frame 2: it has 0 to 1" in fails(made_up, "synth", "preview", "--frame", "2")
    assert "only the drives of 'synthetic' are made up" in fails(labelled, "synth", "preview")
    assert "fire truck: fire engine, " in upvl(made_up, "synth", "kinds").stdout


def test_other_settings_of_the_city_make_its_shards_stale_but_another_drive_does_not(tmp_path: Path) -> None:
    made_up = make_workspace(tmp_path, raw__dataset='"synthetic"', synthetic__frames="1")
    assert upvl(made_up, "odometry").returncode == 0
    set_value(made_up, "synthetic", "val", "1")
    assert upvl(made_up, "odometry", "--segment", "train-000").stdout == ""
    assert "segment=val-000" in upvl(made_up, "odometry").stdout
    set_value(made_up, "synthetic", "seed", "1")
    assert "stale" in upvl(made_up, "status").stdout
    set_value(made_up, "synthetic", "held_out", '["fire trucks"]')
    assert "held_out has 'fire trucks', which is no kind of object; did you mean 'fire truck'?" in fails(
        made_up, "odometry"
    )


@pytest.mark.slow
def test_make_makes_the_same_bytes_and_then_nothing(labelled: Path, tmp_path: Path) -> None:
    folder = make_workspace(tmp_path, **SHORT)
    shutil.copy(ROOT / "workspace.mk", folder / "Makefile")
    make = ["make", "--jobs=2", f"UPVL_COMMAND={UPVL}"]
    done = subprocess.run(make, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    made = shards(folder)
    assert {name: made[name] for name in shards(labelled)} == shards(labelled)
    assert "out/detect/street-0.parquet" in made
    again = subprocess.run(make, cwd=folder, capture_output=True, text=True)
    assert not [line for line in again.stdout.splitlines() if line.startswith("made ")]


def test_a_clock_that_jumped_neither_blocks_nor_remakes(copy: Path) -> None:
    ahead = time.time() + 3600
    for path in copy.glob("out/*/*"):
        os.utime(path, (ahead, ahead))
    os.utime(copy / "out" / "nms" / "street-0.parquet", (0, 0))
    assert made(upvl(copy, "autolabel", "--moving-only")) == []
    shutil.copy(ROOT / "workspace.mk", copy / "Makefile")
    make = ["make", f"UPVL_COMMAND={UPVL}", "nms"]
    assert "made " not in subprocess.run(make, cwd=copy, capture_output=True, text=True, check=True).stdout
    assert subprocess.run([*make, "--question"], cwd=copy, capture_output=True).returncode in (0, 1)


def damage(path: Path) -> None:
    """Turn some bytes of the pages round, and leave size and time as they are."""
    content, found = bytearray(path.read_bytes()), path.stat()
    middle = len(content) // 8  # the pages: what says where they are stands behind them
    content[middle : middle + 40] = bytes(255 - byte for byte in content[middle : middle + 40])
    path.write_bytes(content)
    os.utime(path, ns=(found.st_mtime_ns, found.st_mtime_ns))


@pytest.mark.parametrize("command", [["summary"], ["draw"], ["eval", "--class-agnostic"]])
def test_a_damaged_shard_is_named(copy: Path, command: list[str]) -> None:
    damage(copy / "out" / "nms" / "street-0.parquet")
    assert "out/nms/street-0.parquet is damaged" in fails(copy, *command)


def test_a_damaged_input_is_named_and_nothing_else_is_blamed(copy: Path) -> None:
    damage(copy / "out" / "ground" / "street-0.parquet")
    set_value(copy, "flow", "min_points", "11")
    assert "out/ground/street-0.parquet is damaged" in fails(copy, "autolabel", "--moving-only")


def test_what_is_no_mark_and_no_timing_is_passed_over(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(copy)
    for content in (b"null", b"\xff", b"[1,2]{}", b'{"stage":"flow"}', b"[" * 100_000):
        for name in ("runs.jsonl", "flow.stamp", "raw/street-0.stamp", "raw/street-0.seen"):
            (copy / "out" / name).write_bytes(content)
        for command in (["status"], ["autolabel", "--moving-only"]):
            assert run(command) == 0, content[:20]
        assert "\nmade " not in capsys.readouterr().out, content[:20]


def test_a_footer_that_is_no_stamp_is_remade(copy: Path) -> None:
    path = copy / "out" / "mask" / "street-0.parquet"
    before = path.read_bytes()
    table = Table(path, PIPELINE.by_name["mask"].row)
    write(path, PIPELINE.by_name["mask"].row, list(table), stamp="[]", counts={})
    assert made(upvl(copy, "autolabel", "--moving-only")) == ["mask"]
    assert path.read_bytes() == before


def test_runs_at_once_and_workers_share_the_work_and_make_the_same_bytes(
    labelled: Path, tmp_path: Path
) -> None:
    folder = make_workspace(tmp_path, **SHORT)
    runs = [
        subprocess.Popen([UPVL, "autolabel", "--moving-only", "--workers", workers], cwd=folder,
                         env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        for workers in ("1", "2")
    ]  # fmt: skip
    assert [run.wait(timeout=300) for run in runs] == [0, 0]
    assert len((folder / "out" / "runs.jsonl").read_text().splitlines()) == len(PIPELINE.labelling_stages)
    assert shards(folder) == shards(labelled)


def test_a_part_file_that_leads_elsewhere_is_not_followed(copy: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("mine")
    (copy / "out" / "nms" / "street-0.parquet").unlink()
    (copy / "out" / "nms" / ".street-0.parquet.part").symlink_to(outside)
    assert made(upvl(copy, "autolabel", "--moving-only")) == ["nms"]
    assert outside.read_text() == "mine"
    assert not (copy / "out" / "nms" / "street-0.parquet").is_symlink()


@pytest.mark.parametrize("text", ["abc", "", "-1", "1.5", "99999"])
def test_a_number_of_threads_that_is_none(labelled: Path, text: str) -> None:
    set_value(labelled, "ground", "cell_m", "1.0")
    done = upvl(labelled, "autolabel", "--moving-only", UPVL_THREADS=text, UPVL_OUT=f"out-{text}")
    assert done.returncode == 2
    assert "expected a whole number" in done.stderr


def test_stopped_before_anything_is_loaded(tmp_path: Path) -> None:
    for wait_s in (0.1, 0.2, 0.3):
        process = subprocess.Popen([UPVL, "--help"], cwd=tmp_path, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.PIPE, text=True)  # fmt: skip
        time.sleep(wait_s)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        # Before Python itself is up, which takes long on a busy machine, nothing of ours can answer.
        assert process.returncode in (0, 130, -signal.SIGINT)
        assert "Error calling" not in errors


def test_a_killed_parent_leaves_no_workers(tmp_path: Path) -> None:
    drives = [write_drive(tmp_path / "drives", drive=number) for number in (1, 2)]
    folder = make_workspace(tmp_path / "w", raw__dataset='"kitti"', raw__root=f'"{drives[0].root}"')
    process = subprocess.Popen([UPVL, "autolabel", "--moving-only", "--workers", "2"], cwd=folder,
                               stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)  # fmt: skip
    time.sleep(1.5)
    process.kill()
    assert process.stdout is not None
    process.stdout.read()  # ends only when no child holds the other end
    process.wait(timeout=10)


def test_a_bad_drive_does_not_keep_the_others_from_being_labelled(tmp_path: Path) -> None:
    drives = [write_drive(tmp_path / "drives", drive=number) for number in (1, 2)]
    (drives[0].folder / "velodyne_points" / "data" / "0000000001.bin").write_bytes(b"")
    for workers in ("1", "2"):
        folder = make_workspace(tmp_path / workers, raw__dataset='"kitti"', raw__root=f'"{drives[0].root}"')
        line = fails(folder, "autolabel", "--moving-only", "--workers", workers)
        assert "1 of 2 drives failed, the others are done" in line
        assert "0000000001.bin" in line
        assert (folder / "out" / "nms" / f"{drives[1].segment}.parquet").is_file()


def shards(workspace: Path) -> dict[str, bytes]:
    """Every shard of a workspace, byte by byte."""
    return {str(path.relative_to(workspace)): path.read_bytes() for path in workspace.glob("out/*/*.parquet")}


def test_ctrl_c_is_one_line_and_leaves_no_half_file(tmp_path: Path) -> None:
    folder = make_workspace(tmp_path)
    process = subprocess.Popen([UPVL, "autolabel", "--moving-only"], cwd=folder, stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)  # fmt: skip
    assert process.stdout is not None
    process.stdout.readline()  # the first shard is made: the run is under way
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.strip() == (
        "upvl: stopped; what was finished is kept, and the same command goes on from there"
    )
    assert not list(folder.glob("out/**/.*.part"))


def test_timings_stand_beside_the_shards(labelled: Path) -> None:
    lines = [json.loads(line) for line in (labelled / "out" / "runs.jsonl").read_text().splitlines()]
    assert [line["stage"] for line in lines] == [stage.name for stage in PIPELINE.labelling_stages]


def test_the_page_of_the_stages_is_up_to_date(tmp_path: Path) -> None:
    done = upvl(ROOT, "docs", str(tmp_path / "pipeline.md"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "pipeline.md").read_text() == (ROOT / "docs" / "pipeline.md").read_text(), (
        "run: make docs"
    )
