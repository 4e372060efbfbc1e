"""Shards made on a Ray cluster of several nodes on this machine, whose workers and nodes are killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_executors import Listener, logged, run

from toy_pipeline import check_number, numbered_shards, numbers_workspace
from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.executors.base import ATTEMPTS
from upvl_cli.pipeline.executors.choose import choose
from upvl_cli.pipeline.executors.ray_cluster import RayExecutor

pytest.importorskip("ray")
DRIVES = 6


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one core each."""
    import ray
    from ray.cluster_utils import Cluster

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    store = {"object_store_memory": 80 * 2**20}
    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False, **store})
    found.add_node(num_cpus=1, **store)
    ray.init(address=found.address, log_to_driver=False, logging_level="error")
    yield found
    ray.shutdown()
    found.shutdown()


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    from upvl_cli.pipeline.executors.serial import SerialExecutor

    workspace = numbers_workspace(tmp_path_factory.mktemp("serial") / "w", DRIVES)
    run(workspace, SerialExecutor())
    return numbered_shards(workspace)


@pytest.mark.slow
def test_a_cluster_makes_the_same_bytes_and_reports_each_shard(
    tmp_path: Path, cluster: Any, expected: dict[str, bytes]
) -> None:
    workspace, listener = numbers_workspace(tmp_path / "w", DRIVES), Listener()
    made = run(workspace, RayExecutor(None), listener)
    assert numbered_shards(workspace) == expected
    assert len(made) == len(expected) == 3 * DRIVES + 1
    assert all(" process " in where for where in listener.where)
    assert all(shard.fresh for shard in run(workspace, RayExecutor(None)))


@pytest.mark.slow
def test_lost_workers_are_replaced_and_nothing_finished_is_made_again(
    tmp_path: Path, cluster: Any, expected: dict[str, bytes]
) -> None:
    workspace = numbers_workspace(tmp_path / "w", DRIVES)
    (tmp_path / "w" / "raw" / "kill-drive-001").write_text("2")
    (tmp_path / "w" / "raw" / "kill-drive-003").write_text("1")
    run(workspace, RayExecutor(None))
    assert numbered_shards(workspace) == expected
    assert set(logged(workspace).values()) == {1}


@pytest.mark.slow
def test_a_drive_that_kills_every_worker_fails_and_the_others_go_on(tmp_path: Path, cluster: Any) -> None:
    workspace = numbers_workspace(tmp_path / "w", DRIVES)
    (tmp_path / "w" / "raw" / "kill-drive-001").write_text("100")
    (tmp_path / "w" / "raw" / "faulty-drive-002").touch()
    (tmp_path / "w" / "raw" / "odd-drive-003").touch()
    message = (
        f"2 of 6 drives failed.*times: its worker was lost .* {ATTEMPTS} times in drive-001; see.*drive-002"
    )
    listener = Listener()
    with pytest.raises(UpvlError, match=message):
        run(workspace, RayExecutor(None), listener, check_number)
    assert listener.texts == ["warning: drive-003 is odd"]
    assert len(list((workspace.out / "square").glob("*.parquet"))) == DRIVES - 2


@pytest.mark.slow
def test_a_lost_node_loses_no_drive(tmp_path: Path, cluster: Any, expected: dict[str, bytes]) -> None:
    workspace = numbers_workspace(tmp_path / "w", DRIVES)
    extra = cluster.add_node(num_cpus=2, object_store_memory=80 * 2**20)
    (tmp_path / "w" / "raw" / "wait-drive-000").write_text("1")
    (tmp_path / "w" / "raw" / "wait-drive-001").write_text("1")
    (tmp_path / "w" / "raw" / "wait-drive-002").write_text("1")

    class NodeKiller(Listener):
        """Kills the node that has two cores when three drives hang: one of them at least hangs there."""

        has_killed = False

        def started(self, started: Any) -> None:
            super().started(started)
            hanging = {"drive-000", "drive-001", "drive-002"}
            if not self.has_killed and hanging <= {begun.segment for begun in self.begun_shards}:
                self.has_killed = True
                for path in (tmp_path / "w" / "raw").glob("wait-*"):
                    path.write_text("0")
                for node in list(cluster.worker_nodes):
                    cluster.remove_node(node, allow_graceful=False)

    run(workspace, RayExecutor(None), NodeKiller())
    assert extra not in cluster.worker_nodes
    assert numbered_shards(workspace) == expected


@pytest.mark.slow
def test_a_bug_in_a_task_ends_the_run(tmp_path: Path, cluster: Any) -> None:
    workspace = numbers_workspace(tmp_path / "w", DRIVES)
    (tmp_path / "w" / "raw" / "bug-drive-002").write_text("1")
    with pytest.raises(ZeroDivisionError, match="a bug"):
        run(workspace, RayExecutor(None))


@pytest.mark.parametrize("text", ["ray:head", "ray:8", "ray://head", "ray://:1", "ray://head:x"])
def test_what_is_no_address_is_one_clear_line(text: str) -> None:
    with pytest.raises(
        BadSetting, match="expected ray, or the address of a cluster such as ray://head:10001"
    ):
        choose(text)
