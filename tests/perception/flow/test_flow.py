"""Flow: things moved by a known motion and seen anew, things that only seem to move, and a real pair."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from flow_pair import errors_on_pair

from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import apply, from_yaw
from upvl_cli.perception.flow.rigid import estimate_rigid_flow
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.perception.registration.config import YawIcpConfig
from upvl_cli.perception.registration.icp import align_yaw
from upvl_cli.stages.flow import FlowConfig

ROOT = Path(__file__).parents[3]
CONFIG = load(FlowConfig, ROOT / "stages" / "flow.toml").rigid
DT_S = 0.1
NOISE_M = 0.01


def flow_mps(source_m: np.ndarray, target_m: np.ndarray, dt_s: float = DT_S) -> np.ndarray:
    return np.asarray(estimate_rigid_flow(source_m, [OtherSweep(target_m, dt_s)], CONFIG))


def surface(corner: tuple[float, ...], *edges: tuple[float, ...], count: int, seed: int) -> np.ndarray:
    """Random points of the parallelogram that two edges span."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(0, 1, (count, 2)) @ np.array(edges)
    return along + corner + rng.normal(0, NOISE_M, (count, 3))


def car(seed: int, count: int = 300) -> np.ndarray:
    """Side and rear of a car around the origin, as a LiDAR on its right behind it sees them."""
    side = surface((-2, -0.9, 0.3), (4, 0, 0), (0, 0, 1.2), count=count, seed=seed)
    rear = surface((-2, -0.9, 0.3), (0, 1.8, 0), (0, 0, 1.2), count=count // 2, seed=seed + 1000)
    return np.concatenate([side, rear])


def walker(seed: int, count: int = 120) -> np.ndarray:
    """The near half of a man 1.7 m tall and 0.5 m wide."""
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(np.pi / 2, 3 * np.pi / 2, count), rng.uniform(0.3, 1.7, count)
    return np.stack([0.25 * np.cos(angle), 0.25 * np.sin(angle), z], axis=1) + rng.normal(
        0, NOISE_M, (count, 3)
    )


def placed(points: np.ndarray, x_m: float, y_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    return apply(from_yaw(yaw_rad, np.array([x_m, y_m, 0.0])), points)


def error_mps(found: np.ndarray, true_mps: np.ndarray) -> float:
    return float(np.linalg.norm(found - true_mps, axis=1).mean())


@pytest.mark.parametrize("heading_rad", [0.0, 0.7, np.pi / 2])
@pytest.mark.parametrize("speed_mps", [2.0, 6.0, 15.0, 25.0])
def test_a_car_gets_its_speed(speed_mps: float, heading_rad: float) -> None:
    way = speed_mps * DT_S * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    source = placed(car(0), 12, 4, heading_rad)
    target = placed(car(1), 12 + way[0], 4 + way[1], heading_rad)
    assert error_mps(flow_mps(source, target), np.append(way, 0) / DT_S) < 0.3


@pytest.mark.parametrize("speed_mps", [1.2, 1.8])
def test_a_walker_gets_his_speed(speed_mps: float) -> None:
    source, target = placed(walker(0), 9, 3), placed(walker(1), 9, 3 - speed_mps * DT_S)
    assert error_mps(flow_mps(source, target), np.array([0, -speed_mps, 0])) < 0.45


def test_a_turning_car_moves_more_at_its_nose() -> None:
    """Each point gets the motion of its own place."""
    turn = from_yaw(0.08, np.array([0.8, 0.1, 0.0]))
    source, target = placed(car(0), 10, 2), placed(apply(turn, car(1)), 10, 2)
    true = (apply(turn, source - (10, 2, 0)) + (10, 2, 0) - source) / DT_S
    assert error_mps(flow_mps(source, target), true) < 0.5


def test_backward_in_time_gives_the_same_velocity() -> None:
    source, before = placed(car(0), 12, 4), placed(car(1), 11.2, 4)
    assert error_mps(flow_mps(source, before, -DT_S), np.array([8.0, 0, 0])) < 0.3


def test_two_cars_that_pass_each_other_keep_apart() -> None:
    ours, theirs = placed(car(0), 12, 0), placed(car(2), 13, 3.2, np.pi)
    target = np.concatenate([placed(car(1), 13, 0), placed(car(3), 11.5, 3.2, np.pi)])
    found = flow_mps(np.concatenate([ours, theirs]), target)
    assert error_mps(found[: len(ours)], np.array([10.0, 0, 0])) < 0.4
    assert error_mps(found[len(ours) :], np.array([-15.0, 0, 0])) < 0.4


def test_a_walker_beside_a_parked_car_moves_alone() -> None:
    parked = [placed(car(seed), 10, 5) for seed in (0, 1)]
    walk = [placed(walker(2), 8.0, 2.5), placed(walker(3), 8.15, 2.5)]
    found = flow_mps(np.concatenate([parked[0], walk[0]]), np.concatenate([parked[1], walk[1]]))
    assert np.abs(found[: len(parked[0])]).max() == 0
    assert error_mps(found[len(parked[0]) :], np.array([1.5, 0, 0])) < 0.5


STILL = {
    "wall, other spots of it": [
        surface((5, 8, 0), (30, 0, 0), (0, 0, 4), count=4000, seed=s) for s in (0, 1)
    ],
    "wall, its seen part slides on": [
        surface((5 + 2 * s, 8, 0), (10, 0, 0), (0, 0, 3), count=1500, seed=s) for s in (0, 1)
    ],
    "wall, seen in lines that shift": [
        np.concatenate(
            [
                surface((5, 8, z + 0.2 * s), (20, 0, 0), (0, 0, 0.001), count=400, seed=10 * s)
                for z in (0.4, 0.9, 1.4)
            ]
        )
        for s in (0, 1)
    ],
    "parked car": [placed(car(s), 9, 4) for s in (0, 1)],
    "parked car, half hidden later": [placed(car(0), 9, 4), placed(car(1), 9, 4)[car(1)[:, 0] < 0]],
    "pole": [placed(walker(s, 40), 6, 5) * (1, 1, 2) for s in (0, 1)],
    "bush": [np.random.default_rng(s).normal((12, -6, 1.2), 0.5, (400, 3)) for s in (0, 1)],
}


@pytest.mark.parametrize("name", STILL)
def test_what_stands_is_not_called_moving(name: str) -> None:
    source, target = STILL[name]
    assert np.linalg.norm(flow_mps(source, target), axis=1).max() < 1.0


def test_what_vanishes_has_no_motion() -> None:
    wall = STILL["wall, other spots of it"]
    gone = placed(walker(5), 40, -9)
    found = flow_mps(np.concatenate([wall[0], gone]), wall[1])
    assert np.abs(found).max() == 0


@pytest.mark.parametrize("counts", [(0, 0), (0, 50), (50, 0), (1, 1), (3, 50)], ids=str)
def test_next_to_nothing_stands_still(counts: tuple[int, int]) -> None:
    source, target = placed(car(0), 9, 4)[: counts[0]], placed(car(1), 10, 4)[: counts[1]]
    found = flow_mps(source, target)
    assert found.shape == (counts[0], 3)
    assert np.abs(found).max(initial=0) == 0


def test_as_exact_as_plain_registration_that_starts_from_the_truth() -> None:
    things = [placed(car(0), 12, 4, 0.3), placed(car(2), -15, -6, 2.0), placed(walker(4), 6, -9)]
    moved = [placed(car(1), 12.9, 4.3, 0.33), placed(car(3), -15.5, -5.2, 2.0), placed(walker(5), 6.16, -9)]
    shift = [(0.9, 0.3), (-0.5, 0.8), (0.16, 0.0)]
    found = np.split(
        flow_mps(np.concatenate(things), np.concatenate(moved)), np.cumsum([len(one) for one in things])[:-1]
    )
    for mine, other, way, ours in zip(things, moved, shift, found, strict=True):
        start = from_yaw(0.0, np.array([*way, 0.0]))
        plain = align_yaw(mine, other, start, YawIcpConfig(radius_m=0.5, max_iterations=50, tolerance_m=1e-5))
        assert error_mps(ours, (apply(plain.target_from_source, mine) - mine) / DT_S) < 1.0


def test_the_same_bytes_every_time() -> None:
    source, target = placed(car(0), 12, 4), placed(car(1), 12.6, 4)
    assert flow_mps(source, target).tobytes() == flow_mps(source, target).tobytes()


@pytest.mark.real
def test_a_real_pair(shared: Path) -> None:
    """Three-way EPE 0.3938 m without motion, 0.0181 for global DBSCAN and ICP, 0.0167 here (2026-11-26)."""
    errors = errors_on_pair(shared / "data" / "flow_pair_a" / "pair.npz", flow_mps)
    assert errors.three_way_epe_m < 0.0175
    assert errors.dynamic_epe_m < 0.037
    assert errors.dynamic_iou > 0.96
