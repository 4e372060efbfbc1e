"""Two sweeps as one: what stands still is at one place in both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import SHIPPED, shifted

from upvl_cli.detector.config import AugmentationConfig, HandCorrectionsConfig, SamplingConfig
from upvl_cli.detector.data.frames import DriveFrames, Source
from upvl_cli.detector.data.scene import TrainingScene
from upvl_cli.detector.data.sweeps import Trajectory, TwoSweeps
from upvl_cli.detector.grid import Grid
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.types import Boxes, Points, empty
from world import SEGMENT, drive, sweep

GRID = Grid((-50, 50), (-20, 20), (-1, 5), 0.5)
WALL_M = np.array([[10.0, 5, 1], [12, 5, 1], [14, 6, 2]])


def points_at(xyz_m: np.ndarray) -> Points:
    n = len(xyz_m)
    return Points(xyz_m, np.full(n, 0.5), np.zeros(n), np.zeros(n), np.zeros(n))


def sweeps(
    poses: np.ndarray, read: Callable[[int], Points], every_ns: int = 10**8, ground_z_m: float = 0.0
) -> TwoSweeps:
    trajectory = Trajectory(np.arange(len(poses)), every_ns * np.arange(len(poses)), poses)
    return TwoSweeps(trajectory, read, ground_z_m, SHIPPED.sweeps)


def test_what_stands_still_stays_where_it_is_while_the_car_moves() -> None:
    poses = from_yaw(np.array([0.3, 0.4]), np.array([[100.0, 50, 0], [101, 50.5, 0]]))
    world_m = apply(poses[1], WALL_M)

    def seen(frame: int) -> Points:
        return points_at(apply(inverse(poses[frame]), world_m))

    found = sweeps(poses, seen, ground_z_m=-2.0).points(1)
    assert found.shape == (6, 6) and found.dtype == np.float32
    np.testing.assert_allclose(found[:3, :3], WALL_M + [0, 0, 2], atol=1e-4)
    np.testing.assert_allclose(found[3:, :3], found[:3, :3], atol=1e-4)
    np.testing.assert_allclose(found[:, 5], [0, 0, 0, -0.1, -0.1, -0.1], atol=1e-6)


def test_the_first_sweep_and_one_after_a_gap_are_alone() -> None:
    poses = np.array([np.eye(4)] * 2)
    assert len(sweeps(poses, lambda _: points_at(WALL_M)).points(0)) == 3
    assert len(sweeps(poses, lambda _: points_at(WALL_M), every_ns=10**9).points(1)) == 3


def test_the_older_sweep_keeps_a_point_of_each_voxel() -> None:
    crowd = np.concatenate([WALL_M, WALL_M + 0.01])
    assert len(sweeps(np.array([np.eye(4)] * 2), lambda _: points_at(crowd)).points(1)) == 6 + 3


def test_features_stay_with_their_points() -> None:
    one = drive()
    assert one.name == SEGMENT
    points = sweeps(one.world_from_ego[:2], lambda frame: sweep(frame)[0]).points(1)
    seen = np.arange(0, len(sweep(1)[0]), 7)
    codes = np.repeat((np.arange(len(seen)) % 100).astype(np.int8)[:, None], 64, axis=1)
    sample = TrainingScene.of_frame(points, seen, codes, empty(Boxes), np.zeros((0, 3))).sample(
        GRID, lambda c: c * 0.5, SHIPPED.sampling, np.random.default_rng(0)
    )
    assert GRID.contains(sample.points).all()
    assert (sample.points[sample.seen, 5] == 0).all()
    inside = GRID.contains(points)
    expected = np.zeros(len(points))
    expected[seen] = codes[:, 0] * 0.5
    np.testing.assert_array_equal(sample.feature[:, 3], expected[inside][sample.seen])
    assert len(sample.seen) == inside[seen].sum() > 100


def test_features_are_learned_from_a_sample_of_the_points() -> None:
    points = np.zeros((20_000, 6), dtype=np.float32)
    points[:, 0] = np.linspace(-5, 5, len(points))
    codes = np.repeat((np.arange(len(points)) % 100).astype(np.int8)[:, None], 64, axis=1)
    whole = TrainingScene.of_frame(points, np.arange(len(points)), codes, empty(Boxes), np.zeros((0, 3)))
    one, other = (
        whole.sample(GRID, lambda c: c * 1.0, SHIPPED.sampling, np.random.default_rng(seed))
        for seed in (0, 1)
    )
    assert len(one.seen) == len(np.unique(one.seen)) == 8192
    assert (one.seen != other.seen).any()
    np.testing.assert_array_equal(one.feature[:, 0], one.seen % 100)


def test_half_of_the_features_are_those_of_objects_however_small() -> None:
    points = np.zeros((20_000, 6), dtype=np.float32)
    points[:, 0] = np.linspace(-5, 5, len(points))
    points[:100, 1], points[100:110, 1] = 10, -10  # two objects, of 100 points and of 10
    boxes = Boxes.from_rows(np.array([[0.0, y, 0, 20, 1, 1, 0] for y in (10, -10)]))
    codes = np.zeros((len(points), 64), np.int8)
    whole = TrainingScene.of_frame(points, np.arange(len(points)), codes, boxes, np.zeros((2, 3)))
    sample = whole.sample(GRID, lambda c: c * 1.0, SHIPPED.sampling, np.random.default_rng(0))
    assert len(sample.seen) == 8192
    assert (np.diff(sample.seen) >= 0).all()
    large, small = (sample.seen < 100).sum(), ((sample.seen >= 100) & (sample.seen < 110)).sum()
    assert large + small == pytest.approx(4096 + 4096 * 110 / 20_000, abs=20)
    assert large / small == pytest.approx(np.sqrt(10), rel=0.1)


def test_a_sweep_as_old_as_the_settings_allow_still_joins() -> None:
    poses = np.array([np.eye(4)] * 2)
    assert len(sweeps(poses, lambda _: points_at(WALL_M), every_ns=5 * 10**8).points(1)) == 6
    assert len(sweeps(poses, lambda _: points_at(WALL_M), every_ns=5 * 10**8 + 1000).points(1)) == 3


def test_intensity_and_elongation_stay_with_their_points() -> None:
    points = Points(WALL_M, [0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0, 0, 0], [0, 0, 0])
    found = sweeps(np.array([np.eye(4)] * 2), lambda _: points).points(1)
    np.testing.assert_allclose(found[:3, 3:5], [[0.1, 0.4], [0.2, 0.5], [0.3, 0.6]], rtol=1e-6)
    np.testing.assert_allclose(found[3:, 3:5], found[:3, 3:5])


def test_the_first_point_of_a_voxel_of_the_older_sweep_stays() -> None:
    line = np.column_stack([np.arange(-0.95, 1, 0.1), np.full(20, 0.1), np.full(20, 0.1)])
    found = sweeps(np.array([np.eye(4)] * 2), lambda _: points_at(line)).points(1)
    np.testing.assert_allclose(found[20:, 0], line[::2, 0], atol=1e-6)  # voxels of 0.2 m


def test_the_number_and_the_share_of_features_are_those_of_the_settings() -> None:
    points = np.zeros((1000, 6), dtype=np.float32)
    points[:, 0] = np.linspace(-5, 5, len(points))
    box = Boxes.from_rows(np.array([[-4.0, 0, 0, 1, 1, 1, 0]]))  # a tenth of the points
    whole = TrainingScene.of_frame(
        points, np.arange(1000), np.zeros((1000, 64), np.int8), box, np.zeros((1, 3))
    )
    for share, expected in ((1.0, 200), (0.5, 110), (0.0, 20)):
        config = SamplingConfig(features_per_frame=200, box_share=share)
        sample = whole.sample(GRID, lambda c: c * 1.0, config, np.random.default_rng(0))
        x = sample.points[sample.seen, 0]
        assert len(x) == 200
        assert ((x >= -4.5) & (x <= -3.5)).sum() == pytest.approx(expected, abs=12)


def test_the_grid_holds_its_near_ends_and_not_its_far_ends() -> None:
    ends = np.array([[-50.0, 0, 0], [0, -20, 0], [0, 0, -1], [50, 0, 0], [0, 20, 0], [0, 0, 5]])
    assert GRID.contains(ends).tolist() == [True] * 3 + [False] * 3


def test_of_each_drive_the_end_is_held_out_and_labels_stand_above_the_road() -> None:
    labels = Boxes.from_rows(np.array([[10.0, 3, -1.0, 4, 2, 1.5, 0.3]]))

    def source(drive: str) -> Source:
        # The first point of each frame tells its drive and its number.
        number = {"a": 0, "b": 100}[drive]
        read = lambda frame: points_at(np.array([[(number + frame) / 10, 0, 0.0]]))  # noqa: E731
        two = sweeps(np.array([np.eye(4)] * 10), read, ground_z_m=-2.0)
        none = np.zeros(0, np.int64), np.zeros((0, 64), np.int8)
        return Source(two, lambda frame: none, lambda frame: (labels, np.ones((1, 3))))

    still = replace(
        SHIPPED,
        held_out=0.3,
        augmentation=AugmentationConfig(
            mirror_probability=0.0, max_turn_rad=0.0, scale_jitter=0.0, pasted_objects=0
        ),
    )
    frames = DriveFrames(
        ["a", "b"], np.array([10, 4]), source, grid=GRID, values=lambda c: c * 1.0, config=still
    )
    assert (frames.train, frames.held_out) == (7 + 3, 3 + 1)
    twice = replace(still, hand_corrections=HandCorrectionsConfig(folder="", weight=3))
    more_often = DriveFrames(
        ["a", "b"],
        np.array([10, 4]),
        source,
        grid=GRID,
        values=lambda c: c * 1.0,
        config=twice,
        corrected={"b"},
    )
    assert (more_often.train, more_often.held_out) == (7 + 3 * 3, 3 + 1)
    first = [round(frames.unchanged(number).points[0, 0] * 10) for number in range(14)]
    assert first == [*range(7), 100, 101, 102, 7, 8, 9, 103]
    np.testing.assert_allclose(frames.unchanged(0).boxes.to_rows(), [[10, 3, 1.0, 4, 2, 1.5, 0.3]])
    number = frames.number_at(5)
    more = {number: shifted(labels, x=5, z=2)}
    sample = frames.augmented(5, more)
    assert round(sample.points[0, 0] * 10) == first[number]
    np.testing.assert_allclose(sample.boxes.center_m, [[10, 3, 1], [15, 3, 1]])
    assert len(frames.augmented(6, more).boxes) == 1
