"""One S3-compatible server for the tests of a module; each test has a bucket folder and a cache of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from object_store import Server, s3_server, use_store

BUCKET = "drives"


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    with s3_server(BUCKET) as running:
        yield running


@pytest.fixture
def store(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Address of an empty folder in the bucket, for this process."""
    use_store(monkeypatch, server.variables, tmp_path / "cache")
    return f"s3://{BUCKET}/{tmp_path.name}"
