"""Copies of sweeps: made when a sweep is read first, of that version of the drive, bounded, and never trusted."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.pipeline.storage.file_cache import FileCache
from upvl_cli.pipeline.sweep_cache import CachedSweeps, cache_beside
from upvl_cli.types import Points
from world import SEGMENT, drive


class CountedDrive:
    """The drive of the tests, and what was read of it."""

    def __init__(self) -> None:
        self.reads: Counter[object] = Counter()

    def opened(self) -> CountedDrive:
        self.reads["opened"] += 1
        return self

    @property
    def ground_z_m(self) -> float:
        self.reads["ground"] += 1
        return -1.75

    def points(self, frame: int) -> Points:
        self.reads[frame] += 1
        return drive().points(frame)


def copies(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.npz") if path.is_file())


def sweeps(source: CountedDrive, folder: Path, stamp: str = "a", most_bytes: int = 10**9) -> CachedSweeps:
    return CachedSweeps(FileCache(folder, most_bytes), SEGMENT, stamp, source.opened)


def same(a: Points, b: Points) -> None:
    for name in ("xyz_ego_m", "intensity", "elongation", "sensor", "time_offset_ns"):
        one, other = getattr(a, name), getattr(b, name)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_a_sweep_is_read_once_and_no_other_is(tmp_path: Path) -> None:
    source = CountedDrive()
    for _ in range(2):
        again = sweeps(source, tmp_path)
        assert again.ground_z_m == -1.75
        same(again.read(3), drive().points(3))
        same(again.read(3), drive().points(3))
    assert source.reads == {"opened": 1, "ground": 1, 3: 1}
    assert len(copies(tmp_path)) == 2


def test_another_version_of_the_drive_is_read_anew(tmp_path: Path) -> None:
    source = CountedDrive()
    sweeps(source, tmp_path, "a").read(3)
    sweeps(source, tmp_path, "b").read(3)
    sweeps(source, tmp_path, "a").read(3)
    assert source.reads[3] == 2


@pytest.mark.parametrize("damage", [b"", b"x" * 100, None])
def test_a_damaged_copy_is_made_again(tmp_path: Path, damage: bytes | None) -> None:
    source = CountedDrive()
    sweeps(source, tmp_path).read(3)
    (path,) = copies(tmp_path)
    whole = path.read_bytes()
    flipped = whole[:500] + bytes([whole[500] ^ 1]) + whole[501:]
    path.write_bytes(flipped if damage is None else damage)
    same(sweeps(source, tmp_path).read(3), drive().points(3))
    assert source.reads[3] == 2
    assert path.read_bytes() == whole


def test_what_was_not_read_for_longest_goes_first(tmp_path: Path) -> None:
    source = CountedDrive()
    sweeps(source, tmp_path).read(0)
    (oldest,) = copies(tmp_path)
    room = 3 * oldest.stat().st_size
    bounded = sweeps(source, tmp_path, most_bytes=room)
    for frame in range(1, 6):
        for age, path in enumerate(sorted(copies(tmp_path), key=lambda path: path.stat().st_mtime)):
            os.utime(path, (10**9 + age, 10**9 + age))
        bounded.read(frame)
    held = copies(tmp_path)
    assert sum(path.stat().st_size for path in held) <= room
    assert oldest not in held and held


def test_copies_stand_beside_the_shards_of_a_local_folder(tmp_path: Path) -> None:
    CachedSweeps(cache_beside(tmp_path / "train"), SEGMENT, "a", CountedDrive().opened).read(0)
    assert len(copies(tmp_path / "train" / "sweeps")) == 1


def test_copies_of_a_remote_folder_stand_among_those_of_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from upvl_cli.pipeline.storage.file_cache import file_cache
    from upvl_cli.pipeline.storage.location import location

    monkeypatch.setenv("UPVL_CACHE", str(tmp_path / "scratch"))
    file_cache.cache_clear()
    try:
        CachedSweeps(
            cache_beside(location("s3://bucket/out/train")), SEGMENT, "a", CountedDrive().opened
        ).read(0)
        assert len(copies(tmp_path / "scratch")) == 1
    finally:
        file_cache.cache_clear()
