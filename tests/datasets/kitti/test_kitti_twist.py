"""Motion compensation against the exact screw motion and against real sweeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial import cKDTree

from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.twist import offsets_s, turn_s, twists, untwist
from upvl_cli.geometry.se3 import apply, from_yaw

MS = 1_000_000

TURNS = {
    "nothing": ({}, 0.0),
    "one frame": ({0: 0}, 0.0),
    "no neighbours": ({0: 0, 2: 200 * MS}, 0.0),
    "even": ({0: 0, 1: 100 * MS, 2: 200 * MS}, 0.1),
    "rounded to 10 ms": ({0: 0, 1: 100 * MS, 2: 210 * MS}, 0.105),
    "a lost turn": ({0: 0, 1: 100 * MS, 2: 200 * MS, 3: 400 * MS, 4: 500 * MS}, 0.1),
    "a time that goes back": ({0: 0, 1: 100 * MS, 2: 50 * MS, 3: 150 * MS}, 0.1),
    "only times that go back": ({0: 100 * MS, 1: 0}, 0.0),
    "every tenth sweep": ({0: 0, 1: 1000 * MS, 2: 2000 * MS}, 0.0),
}


@pytest.mark.parametrize(("time_ns", "seconds"), TURNS.values(), ids=TURNS)
def test_a_turn_is_the_time_between_neighbours(time_ns: dict[int, int], seconds: float) -> None:
    assert turn_s(time_ns) == pytest.approx(seconds)


def test_a_point_is_seen_by_its_azimuth() -> None:
    ahead_left_behind_right = np.array([[5.0, 0, 0], [0, 5, 0], [-5, 1e-9, 0], [0, -5, 0]])
    np.testing.assert_allclose(offsets_s(ahead_left_behind_right, turn_s=0.1), [0, -0.025, -0.05, 0.025])


def test_twists_are_the_true_ones_at_uneven_times() -> None:
    seconds = np.array([0.0, 0.1, 0.21, 0.31])
    yaw = 0.2 * seconds
    # A circle of 50 m: 10 m/s along x, at 0.2 rad/s.
    place = 50 * np.column_stack([np.sin(yaw), 1 - np.cos(yaw), 0 * yaw])
    found = twists((seconds * 1e9).astype(np.int64), from_yaw(yaw, place))
    np.testing.assert_allclose(found, np.tile([10, 0, 0, 0, 0, 0.2], (4, 1)), atol=0.001)


def test_a_changing_speed_is_that_of_the_moment() -> None:
    seconds = np.array([0.0, 0.1, 0.3])
    place = np.column_stack([5 * seconds + 2 * seconds**2, 0 * seconds, 0 * seconds])
    found = twists((seconds * 1e9).astype(np.int64), from_yaw(0 * seconds, place))
    assert found[1, 0] == pytest.approx(5 + 4 * 0.1)


@pytest.mark.parametrize("frames", [0, 1])
def test_without_neighbours_nothing_moves(frames: int) -> None:
    found = twists(np.arange(frames), np.tile(np.eye(4), (frames, 1, 1)))
    assert found.shape == (frames, 6) and not found.any()


def test_nothing_untwisted_is_nothing() -> None:
    assert untwist(np.empty((0, 3)), np.ones(6), np.empty(0)).shape == (0, 3)


speed = st.floats(-20, 20)
rate = st.floats(-0.5, 0.5)


@given(st.tuples(speed, speed, speed), st.tuples(rate, rate, rate), st.integers(0, 2**32 - 1))
def test_untwisting_is_the_screw_motion_at_each_points_time(
    velocity: tuple[float, ...], turning: tuple[float, ...], seed: int
) -> None:
    xyz = np.random.default_rng(seed).uniform(-30, 30, (5, 3))
    (x, y, z) = turning
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = velocity
    slow = [
        apply(expm(generator * seconds), place[None])[0]
        for place, seconds in zip(xyz, offsets_s(xyz, turn_s=0.1), strict=True)
    ]
    twist = np.array([*velocity, *turning])
    np.testing.assert_allclose(untwist(xyz, twist, offsets_s(xyz, turn_s=0.1)), slow, atol=0.06)
    small = twist * 1e-3
    slow_small = [
        apply(expm(generator * 1e-3 * seconds), place[None])[0]
        for place, seconds in zip(xyz, offsets_s(xyz, turn_s=0.1), strict=True)
    ]
    np.testing.assert_allclose(untwist(xyz, small, offsets_s(xyz, turn_s=0.1)), slow_small, atol=1e-7)


@pytest.mark.real
def test_real_sweeps_fit_each_other_best_when_untwisted_this_way(shared: Path) -> None:
    kitti = Kitti(shared / "data/kitti_raw_b")
    drive = kitti.open(kitti.segments[0])
    assert drive.world_from_ego is not None
    time_ns = np.array([frame.time_ns for frame in drive.frames])
    motion = twists(time_ns, drive.world_from_ego)

    def close(first: int, second: int, sign: float) -> float:
        """Share of the standing points of one sweep within 10 cm of those of another."""
        worlds = []
        for step in (first, second):
            xyz = drive.points(drive.frames[step].index).xyz_ego_m.astype(np.float64)
            back = untwist(xyz, -motion[step], offsets_s(xyz, turn_s=drive.turn_s))  # as it was seen, nearly
            xyz = untwist(back, sign * motion[step], offsets_s(back, turn_s=drive.turn_s))
            near = (xyz[:, 2] > -1.2) & (np.hypot(xyz[:, 0], xyz[:, 1]) < 40)
            worlds.append(apply(drive.world_from_ego[step], xyz[near]))
        return float((cKDTree(worlds[0]).query(worlds[1], distance_upper_bound=0.1)[0] < 0.1).mean())

    shares = {sign: np.mean([close(step, step + 10, sign) for step in (2, 14, 26)]) for sign in (-1, 0, 1)}
    assert shares[1] > shares[0] > shares[-1]
