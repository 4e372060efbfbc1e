"""No label takes part in labelling: a whole run neither opens one nor changes when they do."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from command import make_workspace
from tiny_kitti import TinyDrive, write_drive

# The first argument names the file for what is opened or listed; the rest are those of `upvl`. Python
# tells an audit hook of every file that it opens and every folder that it lists, below any library of its own.
WATCHED = """
import json, os, sys
from pathlib import Path

seen = set()
def note(event, arguments):
    if event in {"open", "os.listdir", "os.scandir"} and isinstance(arguments[0], (str, bytes, os.PathLike)):
        seen.add(os.fsdecode(arguments[0]))
sys.addaudithook(note)

from upvl_cli.cli import app
report = sys.argv.pop(1)
try:
    app()
except SystemExit as end:
    modules = sorted(name for name in sys.modules if name.startswith("upvl_cli"))
    Path(report).write_text(json.dumps({"code": end.code, "seen": sorted(seen), "modules": modules}))
"""


# Modules that can open a human label.
READS_LABELS = (
    r"upvl_cli\.(datasets\.label_registry|datasets\..*\.(labels|tracklets|objects|annotations)"
    r"|synthetic\.labels)$"
)


@pytest.fixture
def drive(tmp_path: Path) -> TinyDrive:
    """A drive with labels of both kinds that KITTI has."""
    drive = write_drive(tmp_path / "drives", frames=8)
    write_objects(drive, "Car 0 0 0 0 0 0 0 1.5 1.8 4.0 1.0 1.5 12.0 0.0\n")
    return drive


def write_objects(drive: TinyDrive, text: str) -> None:
    (drive.folder / "object_label_2").mkdir(exist_ok=True)
    (drive.folder / "object_label_2" / "0000000000.txt").write_text(text)


def labelled(drive: TinyDrive, folder: Path) -> tuple[dict[str, bytes], dict[str, list[str]]]:
    """Every shard of a fresh run, and what the process opened and imported."""
    make_workspace(folder, raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    # What a person corrected in an earlier run is human work as well; a damaged file would stop whoever opens it.
    (folder / "out" / "corrections").mkdir(parents=True)
    (folder / "out" / "corrections" / f"{drive.segment}.parquet").write_bytes(b"no table")
    command = [sys.executable, "-c", WATCHED, folder / "report.json", "autolabel", "--moving-only"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert (folder / "report.json").exists(), done.stderr
    report = json.loads((folder / "report.json").read_text())
    assert report["code"] == 0, done.stderr
    made = [path for path in folder.glob("out/*/*.parquet") if path.parent.name != "corrections"]
    shards = {str(path.relative_to(folder)): path.read_bytes() for path in made}
    return shards, report


def test_a_run_opens_no_label(drive: TinyDrive, tmp_path: Path) -> None:
    shards, report = labelled(drive, tmp_path / "run")
    assert shards
    opened = report["seen"]
    assert any("velodyne_points" in path for path in opened), "the hook saw nothing"
    assert not [path for path in opened if "tracklet" in path or "object_label" in path]
    assert not [path for path in opened if "out/corrections" in path]
    assert not [name for name in report["modules"] if re.match(READS_LABELS, name)]
    assert not [name for name in report["modules"] if "evaluation" in name]


def test_labels_do_not_change_a_byte(drive: TinyDrive, tmp_path: Path) -> None:
    with_labels, _ = labelled(drive, tmp_path / "with")
    (drive.folder / "tracklet_labels.xml").write_bytes(b"\x00<no xml")
    write_objects(drive, "Car not a number\n")
    assert labelled(drive, tmp_path / "spoilt")[0] == with_labels
    (drive.folder / "tracklet_labels.xml").unlink()
    shutil.rmtree(drive.folder / "object_label_2")
    assert labelled(drive, tmp_path / "without")[0] == with_labels
