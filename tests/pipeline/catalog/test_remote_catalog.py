"""Freshness over an object store: one listing a stage, and footers read only where the catalogue does not know them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pytest
from conditions import by_arrays, one_by_one, run
from scaled_numbers import make, workspace_of

from object_store import Server, s3_server, use_store
from upvl_cli.pipeline.catalog import listing
from upvl_cli.pipeline.storage.listing import list_objects
from upvl_cli.pipeline.storage.remote_path import RemotePath

DRIVES = 5
OUT = RemotePath("s3:", "bucket", "out")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with s3_server("bucket", "names") as running:
        yield running


@pytest.fixture
def folder(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace whose shards are in the store."""
    use_store(monkeypatch, server.variables, tmp_path / "cache")
    for key in list(OUT.bucket.keys("")):
        OUT.bucket.delete(key)
    run(make(tmp_path / "w", DRIVES))
    for path in sorted((tmp_path / "w" / "out").rglob("*.parquet")):
        put(path.relative_to(tmp_path / "w" / "out"), path.read_bytes())
    return tmp_path / "w"


def put(place: str | Path, content: bytes) -> None:
    OUT.bucket.put((OUT / place).key, content)


def test_a_store_gives_the_answer_of_each_shard(folder: Path) -> None:
    opened: list[int] = []
    assert set(by_arrays(workspace_of(folder, out=OUT), tick=lambda: opened.append(1)).values()) == {"fresh"}
    assert len(opened) == 3 * DRIVES
    assert (OUT / "catalog" / "scale.parquet").is_file()
    opened.clear()
    scale = (OUT / "scale" / "d1.parquet").read_bytes()
    put("scale/d1.parquet", scale.replace(b'"factor": 2.0', b'"factor": 5.0'))  # of equal size
    put("double/d2.parquet", (OUT / "double" / "d2.parquet").read_bytes()[:-1])
    (OUT / "double" / "d3.parquet").unlink()
    put("double/d4.seen", b"no shard")
    found = by_arrays(workspace_of(folder, out=OUT), tick=lambda: opened.append(1))
    assert found == one_by_one(workspace_of(folder, out=OUT))
    assert found["scale", "d1"] == "stale"
    assert found["double", "d2"] == found["double", "d3"] == "missing"
    assert len(opened) == 2  # those that were replaced


def test_ranges_of_a_listing_hold_each_name_once(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_store(monkeypatch, server.variables, tmp_path / "cache")
    root = RemotePath("s3:", "names", "stage")
    names = ["a", "a-b", "a.b", "b", "b0", "c", "zz"]
    for name in names:
        root.bucket.put(f"stage/{name}.parquet", name.encode() * 3)
    for other in ("stage/b.seen", "stage/deep/b.parquet", "stagea/b.parquet", "stage"):
        root.bucket.put(other, b"other")
    keys = sorted(f"{name}.parquet" for name in names)
    for splits in ([], keys, keys[2:4], ["b", "bb.parquet"], ["zzz.parquet"]):
        found = list_objects(root, ".parquet", splits)
        assert found["name"].to_pylist() == [key.removesuffix(".parquet") for key in keys], splits
        assert found["size"].to_pylist() == [3 * len(name) for name in found["name"].to_pylist()]
    monkeypatch.setattr(listing, "_PART_NAMES", 2)
    assert listing.list_shards(root, pa.array(names)).segment.to_pylist() == found["name"].to_pylist()
    assert not len(listing.list_shards(root / "none", pa.array(names)).segment)
