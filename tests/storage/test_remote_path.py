"""Paths of objects answer as paths of files do."""

from __future__ import annotations

import os
import pickle
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.errors import BadSetting, StorageError
from upvl_cli.pipeline.storage.location import location
from upvl_cli.pipeline.storage.remote_path import RemotePath
from upvl_cli.runtime.atomic import NotNeeded, atomic_file, atomic_path, write_if_changed


def put(path: Path, content: bytes) -> Path:
    with atomic_file(path) as file:
        file.write(content)
    return path


def test_a_path_is_put_together_as_any_other_and_keeps_its_kind(store: str) -> None:
    path = location(store) / "labels" / "drive-1.parquet"
    assert isinstance(path, RemotePath)
    assert str(path) == f"{store}/labels/drive-1.parquet"
    assert (path.name, path.stem, path.parent.name) == ("drive-1.parquet", "drive-1", "labels")
    assert path.with_name("other") == location(f"{store}/labels/other")
    assert pickle.loads(pickle.dumps(path)) == path
    assert location(Path(store)) == location(store)  # as a command line hands it on


def test_what_was_written_is_read_back_by_all_ways(store: str) -> None:
    path = put(location(store) / "a" / "numbers.npy", b"")
    with atomic_file(path) as file:
        np.save(file, np.arange(5))
    assert np.load(path).tolist() == [0, 1, 2, 3, 4]
    with open(path, "rb") as file:
        content = file.read()
    assert path.read_bytes() == content
    assert path.stat().st_size == len(content)
    assert abs(path.stat().st_mtime - time.time()) < 100
    assert Path(os.fspath(path)).suffix == ".npy"


def test_folders_are_listed(store: str) -> None:
    root = location(store)
    for name in ("b/two.txt", "b/deep/three.txt", "one.txt", ".hidden"):
        put(root / name, b"x")
    assert [path.name for path in root.iterdir()] == [".hidden", "b", "one.txt"]
    assert [str(path) for path in root.glob("*/*.txt")] == [f"{store}/b/two.txt"]
    assert [path.name for path in root.rglob("*.txt")] == ["three.txt", "two.txt", "one.txt"]
    assert (root / "b").is_dir() and not (root / "b").is_file()
    assert (root / "one.txt").is_file() and not (root / "one.txt").is_dir()
    assert not (root / "c").exists()


def test_what_is_not_there_is_missing_as_a_file_is(store: str) -> None:
    path = location(store) / "none"
    for read in (path.read_bytes, path.stat, path.unlink, lambda: np.load(path), lambda: os.stat(path)):
        with pytest.raises(FileNotFoundError) as caught:
            read()
        assert str(path) in str(caught.value)
    assert not os.path.exists(path)
    path.unlink(missing_ok=True)


def test_another_version_is_never_read_from_the_cache(store: str) -> None:
    path = put(location(store) / "a.txt", b"first")
    assert path.read_bytes() == b"first"
    again = put(location(store) / "a.txt", b"other")
    assert again.read_bytes() == path.read_bytes() == b"other"


def test_nothing_is_written_where_a_block_fails_or_has_no_need(store: str) -> None:
    path = location(store) / "a.txt"
    with pytest.raises(ZeroDivisionError), atomic_file(path, one_writer=True) as file:
        file.write(b"half")
        raise ZeroDivisionError
    with atomic_file(path, one_writer=True):
        raise NotNeeded
    assert not list(location(store).iterdir())


def test_a_library_writes_a_file_that_becomes_the_object(store: str) -> None:
    with atomic_path(location(store) / "a.bin") as part:
        part.write_bytes(b"made elsewhere")
    assert (location(store) / "a.bin").read_bytes() == b"made elsewhere"


def test_a_text_is_written_only_where_it_differs(store: str) -> None:
    path = location(store) / "a.stamp"
    assert write_if_changed(path, "one")
    assert not write_if_changed(path, "one")
    assert write_if_changed(path, "two")


def test_large_objects_are_read_by_ranges(store: str, tmp_path: Path) -> None:
    content = np.random.default_rng(1).integers(0, 256, 6_000_000, dtype=np.uint8).tobytes()
    path = put(location(store) / "large.bin", content)
    for copy in (tmp_path / "cache").rglob("large.bin"):
        copy.unlink()
    with path.open("rb") as file:
        for start, size in ((0, 10), (5_999_000, 1000), (3_000_000, 400_000), (5_999_990, 100)):
            file.seek(start)
            assert file.read(size) == content[start : start + size]
    assert not list((tmp_path / "cache").rglob("large.bin"))


def test_an_object_that_is_replaced_while_it_is_read_is_never_mixed(store: str, tmp_path: Path) -> None:
    path = put(location(store) / "large.bin", b"a" * 6_000_000)
    for copy in (tmp_path / "cache").rglob("large.bin"):
        copy.unlink()
    with path.open("rb") as file:
        assert file.read(10) == b"a" * 10
        put(location(store) / "large.bin", b"b" * 6_000_000)
        file.seek(3_000_000)
        with pytest.raises(StorageError, match="was replaced while it was read; run again"):
            file.read(10)


def test_the_cache_is_bounded_and_keeps_what_was_used_last(
    store: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from upvl_cli.pipeline.storage import file_cache

    monkeypatch.setattr(file_cache, "_GRACE_S", 0.0)
    cache = file_cache.FileCache(tmp_path / "small", 100_000)
    for number in range(20):
        cache.add(f"s3://b/{number}", lambda file: str(file.write(b"x" * 20_000)))
        cache.held("s3://b/0", "20000")
        time.sleep(0.01)
    held = [number for number in range(20) if cache.held(f"s3://b/{number}", "20000")]
    assert held == [0, 16, 17, 18, 19]


def test_a_second_writer_waits_for_the_first(store: str) -> None:
    path = location(store) / "shard.parquet"
    order = []

    def second() -> None:
        with atomic_file(path, one_writer=True) as file:
            order.append(path.exists())
            file.write(b"second")

    with atomic_file(path, one_writer=True) as file:
        thread = threading.Thread(target=second)
        thread.start()
        time.sleep(0.6)
        assert not order
        file.write(b"first")
    thread.join(30)
    assert order == [True]
    assert [entry.name for entry in location(store).iterdir()] == ["shard.parquet"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ftp://host/x", "unknown kind of address"),
        ("s3://key:secret@bucket/x", "holds credentials"),
        ("s3:///x", "expected the name of a bucket"),
        ("s3://bucket/a/../b", "'..'"),
        ("s3://b", "expected the name of a bucket"),
    ],
)
def test_an_address_that_makes_no_sense_is_refused(text: str, expected: str) -> None:
    with pytest.raises(BadSetting) as caught:
        location(text)
    assert expected in str(caught.value)
    assert "secret" not in str(caught.value)


def test_the_package_that_is_missing_is_named(store: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(BadSetting, match=r"needs the package obstore; run: pip install 'upvl\[storage\]'"):
        (location(store) / "a").read_bytes()
