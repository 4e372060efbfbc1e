"""Commands on a workspace whose drives lie in an object store."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from command import make_workspace, upvl
from object_store import Server, upload
from tiny_kitti import write_drive
from upvl_cli.commands.import_drive import ImportRequest, import_drive
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace

DRIVE = "2011_09_26_drive_0001_sync"


def workspace_of(folder: Path, root: object) -> Path:
    return make_workspace(folder, raw__dataset='"kitti"', raw__root=json.dumps(str(root)))


def opened(folder: Path) -> Workspace:
    return Workspace(PIPELINE, folder / "stages", folder / "out")


@pytest.mark.slow
def test_commands_read_the_drives(store: str, server: Server, tmp_path: Path) -> None:
    write_drive(tmp_path / "disk")
    upload(tmp_path / "disk", store)
    environment = {**server.variables, "UPVL_CACHE": str(tmp_path / "cache")}
    remote = workspace_of(tmp_path / "remote", store)
    local = workspace_of(tmp_path / "local", tmp_path / "disk")
    done = upvl(remote, "segments", **environment)
    assert (done.returncode, done.stdout.strip()) == (0, DRIVE), done.stderr
    checks = [
        upvl(folder, "check", "--quick", "--json", **environment).stdout.replace(str(root), "ROOT")
        for folder, root in ((remote, store), (local, tmp_path / "disk"))
    ]
    assert checks[0] == checks[1] and DRIVE in checks[0]
    for folder in (remote, local):
        done = upvl(folder, "odometry", **environment)
        assert done.returncode == 0, done.stderr
    shards = [pq.read_table(folder / f"out/odometry/{DRIVE}.parquet") for folder in (remote, local)]
    assert repr(shards[0].to_pylist()) == repr(shards[1].to_pylist())


def test_stamps_differ_by_the_content_digest_alone(store: str, tmp_path: Path) -> None:
    """The digest of a drive in a store is made of versions of its objects: another one than that of its bytes."""
    write_drive(tmp_path / "disk")
    upload(tmp_path / "disk", store)
    remote = opened(workspace_of(tmp_path / "remote", store))
    local = opened(workspace_of(tmp_path / "local", tmp_path / "disk"))
    found, expected = (json.loads(workspace.raw_stamp(DRIVE)) for workspace in (remote, local))
    assert found.pop("content") != expected.pop("content")
    assert found == expected
    again = json.loads(opened(tmp_path / "remote").raw_stamp(DRIVE))["content"]
    assert again == json.loads(remote.raw_stamp(DRIVE))["content"]


def test_a_recording_in_a_store_is_refused_in_one_line(tmp_path: Path) -> None:
    for request in (
        ImportRequest(Path("s3://bucket/recording"), tmp_path),
        ImportRequest(tmp_path, Path("s3://bucket/drives")),
    ):
        with pytest.raises(BadSetting, match=r"^s3://bucket/\w+ is in an object store") as failure:
            import_drive(request, lambda *_: None)
        assert "\n" not in str(failure.value)
