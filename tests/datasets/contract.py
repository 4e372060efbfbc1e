"""What every adapter of a dataset promises, as assertions: call `check_dataset` on drives of each."""

from __future__ import annotations

import math
import re
import threading
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.datasets.labels import LabelSource
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Dataset, Drive, Points

NAME = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9._-]+")
MIN_STEP_NS = 1_000_000


def check_dataset(dataset: Dataset, *, max_frames: int = 5) -> None:
    """Assert what a dataset and all of its drives promise.

    Args:
        dataset: The dataset.
        max_frames: Sweeps and pictures of so many frames of each drive are read.
    """
    assert isinstance(dataset.version, int)
    assert dataset.segments, "a dataset has a segment, or opening it raises BadInput"
    assert list(dataset.segments) == sorted(set(dataset.segments))
    assert all(NAME.fullmatch(name) for name in dataset.segments)
    with pytest.raises(BadInput) as failure:
        dataset.open("no-such-segment")
    assert_one_line(failure.value)
    assert "no-such-segment" in str(failure.value)
    for segment in dataset.segments:
        drive = dataset.open(segment)
        assert drive.name == segment
        check_drive(drive, max_frames)
        again = dataset.open(segment)
        first = drive.frames[0].index
        assert_same_points(drive.points(first), again.points(first))


def check_drive(drive: Drive, max_frames: int = 5) -> None:
    """Assert what a drive promises."""
    check_frames(drive)
    check_poses(drive)
    assert math.isfinite(drive.ground_z_m) and abs(drive.ground_z_m) < 20
    assert all(isinstance(reason, str) and count > 0 for reason, count in drive.skipped.items())
    assert all(isinstance(path, Path) and path.is_file() for path in drive.files)
    assert len(set(drive.files)) == len(drive.files)
    chosen = drive.frames[:max_frames]
    for frame in chosen:
        check_points(drive.points(frame.index))
    check_cameras(drive, [frame.index for frame in chosen])
    check_any_order(drive, [frame.index for frame in chosen])
    missing = drive.frames[-1].index + 1000
    for read in (lambda: drive.points(missing), lambda: drive.image(drive.frames[0].index, "no-such-camera")):
        with pytest.raises(BadInput) as failure:
            read()
        assert_one_line(failure.value)


def check_frames(drive: Drive) -> None:
    """Assert that frames ascend in index and time."""
    assert drive.frames
    assert all(type(frame.index) is int and type(frame.time_ns) is int for frame in drive.frames)
    for before, after in zip(drive.frames, drive.frames[1:], strict=False):
        assert after.index > before.index
        assert after.time_ns - before.time_ns >= MIN_STEP_NS


def check_poses(drive: Drive) -> None:
    """Assert that poses, where there are some, are rigid, one a frame."""
    poses = drive.world_from_ego
    if poses is not None:
        assert poses.shape == (len(drive.frames), 4, 4) and poses.dtype == np.float64
        assert_rigid(poses)


def assert_rigid(poses: Array) -> None:
    """Assert that matrices are rotations and translations."""
    assert np.isfinite(poses).all()
    rotation = poses[..., :3, :3]
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), rotation.shape), atol=2e-3
    )
    assert (np.linalg.det(rotation) > 0).all()
    np.testing.assert_array_equal(poses[..., 3, :], np.broadcast_to([0, 0, 0, 1], poses[..., 3, :].shape))


def check_points(points: Points) -> None:
    """Assert units and ranges of a sweep."""
    assert points.xyz_ego_m.dtype == np.float32
    assert np.isfinite(points.xyz_ego_m).all()
    assert np.abs(points.xyz_ego_m).max(initial=0) < 1e4
    assert ((points.intensity >= 0) & (points.intensity <= 1)).all()
    assert np.isfinite(points.elongation).all()
    assert (np.abs(points.time_offset_ns) < 2_000_000_000).all()


def check_cameras(drive: Drive, frames: list[int]) -> None:
    """Assert that pictures have the size of their calibration, and cameras a mount on the car."""
    names = [camera.name for camera in drive.cameras]
    assert len(set(names)) == len(names)
    for camera in drive.cameras:
        assert_rigid(camera.ego_from_camera)
        assert np.abs(camera.ego_from_camera[:3, 3]).max() < 100
        np.testing.assert_array_equal(camera.intrinsic[2], [0, 0, 1])
        for frame in frames:
            image = drive.image(frame, camera.name)
            if image is not None:
                assert image.rgb.shape == (camera.height_px, camera.width_px, 3)
                assert image.rgb.dtype == np.uint8
                assert type(image.time_ns) is int


def check_any_order(drive: Drive, frames: list[int]) -> None:
    """Assert that sweeps are the same in any order, and from two threads at once."""
    forward = {frame: drive.points(frame) for frame in frames}
    found: dict[int, Points] = {}

    def read(order: list[int]) -> None:
        for frame in order:
            found[frame] = drive.points(frame)

    threads = [threading.Thread(target=read, args=(order,)) for order in (frames[::-1], frames)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(found) == set(frames)
    for frame in frames:
        assert_same_points(forward[frame], found[frame])


def check_labels(source: LabelSource, drive: Drive) -> None:
    """Assert what a source of labels promises of a drive that has some."""
    labels = source.labels(drive.name)
    known = {frame.index for frame in drive.frames}
    assert set(labels.frame.tolist()) <= known
    assert set(source.frames(drive.name).tolist()) <= known
    assert set(labels.frame.tolist()) <= set(source.frames(drive.name).tolist())
    assert np.isfinite(labels.to_rows()).all()
    assert (labels.size_lwh_m > 0).all()
    assert ((labels.heading_rad >= -np.pi) & (labels.heading_rad <= np.pi)).all()
    assert set(labels.type.tolist()) <= {0, 1, 2, 3, 4}
    pairs = list(zip(labels.frame.tolist(), labels.object_id.tolist(), strict=True))
    assert len(set(pairs)) == len(pairs), "an object has one box in a frame"
    covered = source.covers(drive.name, labels.center_m)
    assert covered.shape == (len(labels),) and covered.dtype == np.bool_


def assert_same_points(a: Points, b: Points) -> None:
    """Assert that two sweeps are equal, bit for bit."""
    for name in ("xyz_ego_m", "intensity", "elongation", "sensor", "time_offset_ns"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def assert_one_line(error: BaseException) -> None:
    """Assert that a message is one line that is not endless."""
    assert str(error).strip()
    assert "\n" not in str(error)
    assert len(str(error)) < 1500


def read_everything(dataset_of: object, labels_of: object = None) -> str | None:
    """Return None where all of a damaged dataset can be read, else the one line that says why not.

    Args:
        dataset_of: A function that opens the dataset.
        labels_of: A function of the dataset that opens its labels, or None.
    """
    try:
        dataset: Dataset = dataset_of()  # type: ignore[operator]
        for segment in dataset.segments:
            drive = dataset.open(segment)
            for frame in drive.frames:
                drive.points(frame.index)
                for camera in drive.cameras:
                    drive.image(frame.index, camera.name)
            if labels_of is not None:
                source: LabelSource = labels_of(dataset)  # type: ignore[operator]
                source.frames(segment)
                source.covers(segment, source.labels(segment).center_m)
    except BadInput as error:
        assert_one_line(error)
        return str(error)
    return None
