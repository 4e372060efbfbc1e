"""Bad input: one clear line that says what and where, exit code 2, and no half file."""

from __future__ import annotations

import os
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from command import UPVL, fails, make_workspace, set_value, upvl
from tiny_kitti import TinyDrive, write_drive


@pytest.fixture
def drive(tmp_path: Path) -> TinyDrive:
    return write_drive(tmp_path / "drives")


@pytest.fixture
def workspace(drive: TinyDrive, tmp_path: Path) -> Path:
    return make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')


def sweep(drive: TinyDrive) -> Path:
    return drive.folder / "velodyne_points" / "data" / "0000000002.bin"


def empty(drive: TinyDrive) -> None:
    sweep(drive).write_bytes(b"")


def truncated(drive: TinyDrive) -> None:
    sweep(drive).write_bytes(sweep(drive).read_bytes()[:-7])


def with_nan(drive: TinyDrive) -> None:
    points = np.fromfile(sweep(drive), np.float32)
    points[5] = np.nan
    points.tofile(sweep(drive))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [(empty, "is empty"), (truncated, "16")],
    ids=["empty sweep", "truncated sweep"],
)
def test_a_spoilt_sweep(drive: TinyDrive, workspace: Path, spoil: Callable, message: str) -> None:
    spoil(drive)
    line = fails(workspace, "autolabel", "--moving-only")
    assert "0000000002.bin" in line
    assert message in line
    assert not list(workspace.glob("out/**/.*.part"))


def test_rays_without_return_are_left_out_and_counted(drive: TinyDrive, workspace: Path) -> None:
    with_nan(drive)
    done = upvl(workspace, "autolabel", "--moving-only")
    assert done.returncode == 0, done.stderr
    assert "1 points without a return (not a number)" in done.stdout


def test_malformed_calibration(drive: TinyDrive, workspace: Path) -> None:
    path = drive.folder.parent / "calib_velo_to_cam.txt"
    path.write_text("R: 1 2 three\nT: 0 0 0\n")
    assert "calib_velo_to_cam.txt" in fails(workspace, "autolabel", "--moving-only")


def test_without_calibration_camera_and_poses_all_stages_still_run(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives", images=False, calibration=False, oxts=False)
    folder = make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    done = upvl(folder, "autolabel", "--moving-only")
    assert done.returncode == 0, done.stderr
    assert "4 poses estimated" in done.stdout


def test_a_missing_sweep_is_counted(drive: TinyDrive, workspace: Path) -> None:
    sweep(drive).unlink()
    done = upvl(workspace, "odometry")
    assert done.returncode == 0, done.stderr
    assert "rows=3" in done.stdout


@pytest.mark.parametrize(
    ("stage", "key", "value", "message"),
    [
        ("mask", "min_speed_mps", "-1", "min_speed_mps = -1 must be >= 0"),
        ("mask", "min_speed_mps", "nan", "min_speed_mps = nan must be >= 0"),
        ("mask", "min_speed_mps", "inf", "must be >= 0 and <= 200 m/s"),
        ("mask", "min_speed_mps", "9" * 400, "must be >= 0 and <= 200 m/s"),
        ("mask", "min_speed_mps", "9" * 5000, "is not valid TOML"),
        ("mask", "min_speed_mps", "[" * 500, "is not valid TOML"),
        ("propose", "background.max_share", "1.5", "must be >= 0 and <= 1"),
        ("propose", "clustering.min_points", '"few"', "clustering.min_points = 'few' must be a whole number"),
        (
            "raw",
            "dataset",
            '"kiti"',
            "unknown dataset 'kiti'; did you mean 'kitti'? (known: argoverse2, kitti,",
        ),
        ("raw", "segments", '["none"]', "unknown segment 'none'"),
        ("raw", "segments", '["../../etc"]', "unknown segment '../../etc'"),
        ("raw", "root", '"/nowhere"', "/nowhere"),
    ],
)
def test_a_bad_value(workspace: Path, stage: str, key: str, value: str, message: str) -> None:
    set_value(workspace, stage, key, value)
    assert message in fails(workspace, "autolabel", "--moving-only")
    assert not list(workspace.glob("out/*/*.parquet"))


def test_a_misspelt_key(workspace: Path) -> None:
    path = workspace / "stages" / "mask.toml"
    path.write_text(path.read_text().replace("min_speed_mps", "min_sped_mps"))
    line = fails(workspace, "autolabel", "--moving-only")
    assert "stages/mask.toml" in line
    assert "unknown key 'min_sped_mps'; did you mean 'min_speed_mps'?" in line


def test_a_drive_whose_name_is_no_safe_file_name(workspace: Path, drive: TinyDrive) -> None:
    drive.folder.rename(drive.folder.with_name("a drive; rm_sync"))
    assert "rename it" in fails(workspace, "segments")


def test_an_out_that_cannot_be_written(workspace: Path) -> None:
    (workspace / "out").write_text("a file, not a folder")
    assert "cannot write" in fails(workspace, "autolabel", "--moving-only")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_out(workspace: Path) -> None:
    (workspace / "out").mkdir()
    (workspace / "out").chmod(stat.S_IRUSR | stat.S_IXUSR)
    assert "Permission denied" in fails(workspace, "autolabel", "--moving-only")


def test_a_full_disk(workspace: Path) -> None:
    out = workspace / "small"
    out.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", out], capture_output=True)
    if mounted.returncode:
        pytest.skip("cannot mount a small file system here; the next test has a limit on files instead")
    try:
        line = fails(workspace, "--out", "small", "autolabel", "--moving-only")
        assert "No space left on device" in line
        assert not list(out.glob("**/.*.part"))
    finally:
        subprocess.run(["umount", out], check=True)


def test_a_shard_larger_than_the_system_allows(workspace: Path) -> None:
    command = f"ulimit -f 1; {UPVL} odometry && {UPVL} ground"
    done = subprocess.run(["bash", "-c", command], cwd=workspace, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("upvl: cannot write out/")
    assert "File too large" in done.stderr
    assert not list(workspace.glob("out/**/.*.part"))


def test_a_damaged_shard_is_made_again(workspace: Path) -> None:
    assert upvl(workspace, "odometry").returncode == 0
    path = next((workspace / "out" / "odometry").glob("*.parquet"))
    whole = path.read_bytes()
    path.write_bytes(whole[:100])
    assert upvl(workspace, "odometry").returncode == 0
    assert path.read_bytes() == whole


def test_new_content_of_a_drive_remakes_its_shards_whatever_its_date_and_size(
    workspace: Path, drive: TinyDrive
) -> None:
    assert "made" in upvl(workspace, "odometry").stdout
    os.utime(sweep(drive))
    assert "made" not in upvl(workspace, "odometry").stdout
    found, content = sweep(drive).stat(), bytearray(sweep(drive).read_bytes())
    content[:4] = content[16:20]
    sweep(drive).write_bytes(content)
    os.utime(sweep(drive), ns=(found.st_atime_ns, found.st_mtime_ns))
    assert "the drive's files have changed" in upvl(workspace, "status", COLUMNS="200").stdout
    assert "made" in upvl(workspace, "odometry").stdout
