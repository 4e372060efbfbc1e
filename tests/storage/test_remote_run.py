"""A run whose results lie in an object store has the bytes of one whose results lie on the disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from command import make_workspace, upvl
from object_store import Server
from upvl_cli.pipeline.storage.location import location

COMMANDS = (("autolabel", "--moving-only"), ("train",), ("detect",))


@pytest.mark.slow
def test_labels_and_a_detector_are_the_same_in_a_store(store: str, server: Server, tmp_path: Path) -> None:
    workspace = make_workspace(tmp_path / "work")
    variables = {**server.variables, "UPVL_CACHE": str(tmp_path / "cache-of-run"), "UPVL_OUT": store}
    for arguments in COMMANDS:
        for environment in ({}, variables):
            done = upvl(workspace, *arguments, **environment)
            assert done.returncode == 0, done.stderr
    expected = {
        str(path.relative_to(workspace / "out")): path.read_bytes()
        for path in (workspace / "out").rglob("*.parquet")
    }
    out = location(store)
    found = {str(path).removeprefix(f"{store}/"): path.read_bytes() for path in out.rglob("*.parquet")}
    assert found == expected
    assert "detect/street-0.parquet" in found
    assert not [path for path in out.rglob("*.lease")]
    for arguments in (("status",), ("summary",), ("query", "car", "--on", "detections"), ("labels",)):
        done = upvl(workspace, *arguments, **variables)
        assert done.returncode in (0, 2) and "Traceback" not in done.stderr, done.stderr
