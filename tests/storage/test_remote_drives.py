"""Drives in an object store are read with the same results as from disk, for a bounded number of requests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import boto3
import numpy as np
import pytest

from datasets.argoverse2 import av2_log
from datasets.kitti import kitti_writers
from datasets.nuscenes import nuscenes_tables
from object_store import FaultyProxy, Server, upload, use_store, variables_of
from open_door import write_open_door
from tiny_kitti import write_drive
from tiny_waymo import tiny_segment, write_v1, write_v2
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.datasets.shared.paths import inside
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.storage import block_file
from upvl_cli.pipeline.storage.drive_path import DrivePath
from upvl_cli.pipeline.storage.folder_listings import listings
from upvl_cli.pipeline.storage.location import location
from upvl_cli.types import Dataset, Drive

BUCKET = "drives"


def write_py123d(root: Path) -> None:
    pytest.importorskip("py123d.api")
    from datasets.py123d import py123d_log

    py123d_log.write_log(root)


LAYOUTS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "kitti raw": ("kitti", write_drive),
    "kitti object": ("kitti", kitti_writers.write_object),
    "view of delft": ("kitti", lambda root: kitti_writers.write_object(root, delft=True, digits=5)),
    "kitti tracking": ("kitti", kitti_writers.write_tracking),
    "kitti odometry": ("kitti", kitti_writers.write_odometry),
    "kitti-360": ("kitti", kitti_writers.write_kitti360),
    "nuscenes": ("nuscenes", nuscenes_tables.write_nuscenes),
    "lyft": ("nuscenes", nuscenes_tables.write_lyft),
    "t4": ("nuscenes", nuscenes_tables.write_t4),
    "waymo v2": ("waymo", lambda root: write_v2(root, tiny_segment())),
    "waymo v1": ("waymo", lambda root: write_v1(root, tiny_segment())),
    "argoverse2": ("argoverse2", av2_log.write_log),
    "parquet": ("parquet", write_open_door),
    "py123d": ("py123d", write_py123d),
}


def opened(name: str, root: Path) -> Dataset:
    return dataset_family(name).open(root, None)


def assert_same(found: Any, expected: Any) -> None:
    """Assert that two arrays, or two of one of the classes of arrays, are equal to the bit."""
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(found, expected)
    elif hasattr(expected, "__dataclass_fields__"):
        for item in fields(expected):
            assert_same(getattr(found, item.name), getattr(expected, item.name))
    else:
        assert found == expected


def assert_same_drive(found: Drive, expected: Drive, root: Path, disk: Path) -> None:
    """Assert that all that a drive gives is the same."""
    assert (found.name, found.frames, found.skipped) == (expected.name, expected.frames, expected.skipped)
    assert [str(path)[len(str(root)) :] for path in found.files] == [
        str(path)[len(str(disk)) :] for path in expected.files
    ]
    assert all(isinstance(path, DrivePath) and path.is_file() for path in found.files)
    assert_same(found.world_from_ego, expected.world_from_ego)
    assert_same(list(map(len, (found.cameras, found.frames))), [len(expected.cameras), len(expected.frames)])
    assert found.ground_z_m == expected.ground_z_m
    for camera, expected_camera in zip(found.cameras, expected.cameras, strict=True):
        assert_same(camera, expected_camera)
    for frame in expected.frames:
        assert_same(found.points(frame.index), expected.points(frame.index))
        for camera in expected.cameras:
            assert_same(found.image(frame.index, camera.name), expected.image(frame.index, camera.name))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_drive_in_a_store_is_the_drive_on_disk(layout: str, store: str, tmp_path: Path) -> None:
    name, write = LAYOUTS[layout]
    disk = tmp_path / "disk"
    write(disk)
    upload(disk, store)
    root = location(store, of_drives=True)
    found, expected = opened(name, root), opened(name, disk)
    assert found.segments == expected.segments
    for segment in expected.segments:
        assert_same_drive(found.open(segment), expected.open(segment), root, disk)
    if layout not in ("kitti odometry", "kitti-360"):  # these have no labels
        labels = [label_source(name, at, dataset) for at, dataset in ((root, found), (disk, expected))]
        for segment in expected.segments:
            assert_same(labels[0].labels(segment), labels[1].labels(segment))


@pytest.mark.parametrize("layout", ["waymo v2", "waymo v1", "parquet", "nuscenes"])
def test_of_large_files_blocks_are_read(
    layout: str, store: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("upvl_cli.pipeline.storage.remote_path.WHOLE_BYTES", 0)
    monkeypatch.setattr("upvl_cli.pipeline.storage.drive_path.SWEEP_BYTES", 0)
    monkeypatch.setattr(block_file, "BLOCK_BYTES", 1000)
    name, write = LAYOUTS[layout]
    disk = tmp_path / "disk"
    write(disk)
    upload(disk, store)
    root = location(store, of_drives=True)
    segment = opened(name, disk).segments[0]
    assert_same_drive(opened(name, root).open(segment), opened(name, disk).open(segment), root, disk)
    copies = [path.stat().st_size for path in (tmp_path / "cache" / "objects").rglob("*") if path.is_file()]
    assert copies and max(copies) <= 1000


@pytest.fixture
def counted(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyProxy]:
    """A proxy that counts the requests of this process."""
    proxy = FaultyProxy(server.port, seed=0, share=0.0)
    use_store(monkeypatch, variables_of(proxy.port), tmp_path / "cache")
    yield proxy
    proxy.close()


@pytest.mark.parametrize("layout", ["kitti raw", "nuscenes", "argoverse2", "waymo v2", "parquet"])
def test_a_longer_drive_takes_no_more_looks(layout: str, counted: FaultyProxy, tmp_path: Path) -> None:
    """Of a drive of any length each folder is listed once, and no file is asked for alone."""
    name, write = LAYOUTS[layout]
    if layout == "kitti raw":
        write = lambda root: write_drive(root, frames=30)  # noqa: E731
    elif layout == "argoverse2":
        write = lambda root: av2_log.write_log(root, sweeps=30)  # noqa: E731
    write(tmp_path / "disk")
    upload(tmp_path / "disk", f"s3://{BUCKET}/{tmp_path.name}")
    counted.requests.clear()
    dataset = opened(name, location(f"s3://{BUCKET}/{tmp_path.name}", of_drives=True))
    drive = dataset.open(dataset.segments[0])
    versions = {path.version for path in drive.files if isinstance(path, DrivePath)}
    assert len(versions) > 1
    assert counted.requests["HEAD"] == 0
    assert counted.requests["LIST"] <= 20
    before = counted.requests["GET"]
    for frame in drive.frames:
        drive.points(frame.index)
    again = counted.requests["GET"]
    assert again - before <= len(drive.frames) + 8
    for frame in drive.frames:
        drive.points(frame.index)
    assert counted.requests["GET"] == again
    assert counted.requests["HEAD"] == 0


def test_of_a_huge_folder_only_the_names_of_the_scene_are_listed(
    counted: FaultyProxy, tmp_path: Path
) -> None:
    disk, address = tmp_path / "disk", f"s3://{BUCKET}/{tmp_path.name}"
    for number in range(1100):
        path = disk / "sweeps" / f"log-{number // 100:02d}__{number:05d}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    upload(disk, address)
    counted.requests.clear()
    folder = location(address, of_drives=True) / "sweeps"
    names = [f"log-10__{number:05d}.bin" for number in range(1000, 1030)]
    folder.look_among([*names, "log-10__01005.pcd"])
    assert all((folder / name).is_file() for name in names)
    assert not (folder / "log-10__01005.pcd").is_file()
    assert counted.requests == {"LIST": 1}
    assert (folder / "log-00__00000.bin").is_file()  # the whole folder now
    assert counted.requests == {"LIST": 3}
    assert len(list(folder.iterdir())) == 1100


def test_files_that_are_read_in_order_are_fetched_ahead(counted: FaultyProxy, tmp_path: Path) -> None:
    disk, address = tmp_path / "disk", f"s3://{BUCKET}/{tmp_path.name}"
    disk.mkdir()
    for number in range(40):
        (disk / f"{number:04d}.bin").write_bytes(bytes([number]) * 100)
    upload(disk, address)
    folder = location(address, of_drives=True)
    files = list(folder.iterdir())
    counted.requests.clear()
    assert [path.read_bytes()[0] for path in files] == list(range(40))
    assert counted.requests == {"GET": 40}
    # In no order nothing is fetched that was not asked for.
    use_store_again = folder.parent / f"{folder.name}-other"
    upload(disk, str(use_store_again))
    list(use_store_again.iterdir())
    counted.requests.clear()
    for number in (30, 3, 17):
        assert (use_store_again / f"{number:04d}.bin").read_bytes()[0] == number
    assert counted.requests == {"GET": 3}


def test_no_path_from_data_leaves_the_root(store: str) -> None:
    root = location(store, of_drives=True) / "root"
    assert str((root / "a/../../b").resolve()) == f"{store}/b"
    assert str((root / "../../../../../b").resolve()) == f"s3://{BUCKET}/b"
    assert (root / "a/./b/../c.png").key == (root / "a/c.png").key
    assert inside(root, "images/../other/1.png", "row 1").resolve() == root / "other/1.png"
    for text in ("../secret.png", "images/../../secret.png", "/etc/passwd", "../../../../drives/x"):
        with pytest.raises(BadInput, match="expected the relative path of a file below"):
            inside(root, text, "row 1")


def test_a_missing_folder_is_one_clear_line(store: str) -> None:
    root = location(store, of_drives=True) / "nothing"
    for name in ("kitti", "nuscenes", "waymo", "argoverse2", "parquet"):
        with pytest.raises(BadInput, match=f"{root}") as failure:
            opened(name, root)
        assert "\n" not in str(failure.value)


def test_markers_of_folders_are_no_files(store: str, tmp_path: Path) -> None:
    """Consoles of stores write an empty object for each folder that is made by hand."""
    write_drive(tmp_path / "disk")
    upload(tmp_path / "disk", store)
    client = boto3.client("s3", endpoint_url=os.environ["AWS_ENDPOINT_URL"])
    prefix = store.removeprefix(f"s3://{BUCKET}/")
    for folder in ("", "2011_09_26/", "2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/"):
        client.put_object(Bucket=BUCKET, Key=f"{prefix}/{folder}", Body=b"")
    root = location(store, of_drives=True)
    assert [name for name, _ in root.entries()] == ["2011_09_26"]
    drive = opened("kitti", root).open("2011_09_26_drive_0001_sync")
    assert len(drive.frames) == 4


def test_a_folder_of_copies_is_kept_and_made_once(counted: FaultyProxy, tmp_path: Path) -> None:
    disk, address = tmp_path / "disk", f"s3://{BUCKET}/{tmp_path.name}"
    (disk / "log/deep").mkdir(parents=True)
    (disk / "log/a.arrow").write_bytes(b"aa")
    (disk / "log/deep/b.arrow").write_bytes(b"bbb")
    upload(disk, address)
    folder = location(f"{address}/log", of_drives=True)
    local = folder.local_folder()
    assert (local / "a.arrow").read_bytes() == b"aa" and (local / "deep/b.arrow").read_bytes() == b"bbb"
    gets = counted.requests["GET"]
    listings.cache_clear()
    assert folder.local_folder() == local
    assert counted.requests["GET"] == gets == 2


@pytest.mark.real
def test_a_real_drive_in_a_store_is_the_drive_on_disk(store: str, shared: Path, tmp_path: Path) -> None:
    disk = shared / "data" / "av2_real"
    upload(disk, store)
    root = location(store, of_drives=True)
    found, expected = opened("argoverse2", root), opened("argoverse2", disk)
    assert found.segments == expected.segments
    for segment in expected.segments:
        assert_same_drive(found.open(segment), expected.open(segment), root, disk)
