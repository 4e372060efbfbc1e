"""Clusters of known points become boxes around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.perception.clustering import NOISE
from upvl_cli.perception.proposals.persistence import Places, places
from upvl_cli.perception.proposals.propose import Proposals, Sweep, propose

SETTINGS = {
    "eps_m": 1.0,
    "eps_deg": 0.0,
    "eps_mps": 1.5,
    "min_points": 6,
    "voxel_m": 0.1,
    "cluster_background": True,
    "max_background_share": 0.99,
    "max_lasting_share": 0.5,
    "moving_mps": 1.0,
    "foot_m": 0.3,
    "person_gap_m": 0.2,
}
NOWHERE = places(np.zeros(1), [np.zeros((0, 3))])


def car(x_m: float, y_m: float) -> np.ndarray:
    """Points on the back and one side of a car 4 m long, 2 m wide, 1.5 m high, standing on z = 0."""
    across, along, up = np.arange(-1, 1.01, 0.1), np.arange(-2, 2.01, 0.1), np.arange(0.1, 1.51, 0.2)
    back = np.stack(np.meshgrid([-2.0], across, up), axis=-1).reshape(-1, 3)
    side = np.stack(np.meshgrid(along, [-1.0], up), axis=-1).reshape(-1, 3)
    return np.concatenate([back, side]) + [x_m, y_m, 0]


def sweep(*objects: tuple[np.ndarray, tuple[float, float]]) -> Sweep:
    """Objects, each of points and a velocity; those that do not move are no candidates."""
    xyz = np.concatenate([points for points, _ in objects] or [np.zeros((0, 3))])
    speeds = [np.tile([*velocity, 0.0], (len(points), 1)) for points, velocity in objects]
    velocity = np.concatenate(speeds or [np.zeros((0, 3))])
    moves = np.linalg.norm(velocity, axis=1) >= 1.0
    return Sweep(
        xyz, velocity, moves, np.zeros(len(xyz), bool), np.zeros((len(xyz), 0)), xyz[:, 2], np.eye(4), 0
    )


def found(seen: Sweep, taken: Places = NOWHERE, **changes: float) -> Proposals:
    return propose(seen, taken, **{**SETTINGS, **changes})


def test_a_car_gets_the_tightest_box_along_its_motion() -> None:
    boxes = found(sweep((car(10, 3), (5.0, 0.0))))
    assert len(boxes.seven) == 1
    np.testing.assert_allclose(boxes.seven[0, :2], [10, 3], atol=0.1)
    np.testing.assert_allclose(boxes.seven[0, 3:5], [4, 2], atol=0.15)
    assert abs(boxes.seven[0, 6]) < 0.05
    np.testing.assert_allclose(boxes.velocity_mps[0], [5, 0, 0], atol=1e-6)
    assert boxes.points[0] == len(car(0, 0))


def test_two_cars_that_pass_closely_are_two() -> None:
    boxes = found(sweep((car(10, 1.3), (8.0, 0.0)), (car(10, -1.3), (-8.0, 0.0))))
    assert len(boxes.seven) == 2
    assert sorted(boxes.velocity_mps[:, 0]) == [-8.0, 8.0]


def test_points_that_flow_missed_join_the_box_they_lie_in() -> None:
    seen = sweep((car(10, 3), (5.0, 0.0)))
    missed = np.arange(len(seen.xyz_m)) % 7 == 0
    still = replace(seen, velocity_mps=np.where(missed[:, None], 0, seen.velocity_mps), candidate=~missed)
    assert (found(still).of_point >= 0).all()


def test_background_is_dropped_by_its_share() -> None:
    seen = sweep((car(10, 3), (5.0, 0.0)), (car(30, 3), (5.0, 0.0)))
    half = len(seen.xyz_m) // 2
    walls = replace(seen, background=(np.arange(len(seen.xyz_m)) < half).astype(np.int8))
    kept = found(walls, max_background_share=0.9)
    assert kept.dropped["background"] == 1
    np.testing.assert_allclose(kept.seven[:, 0], [30], atol=0.1)
    assert len(found(walls, max_background_share=1.0).seven) == 2


def test_points_of_which_nothing_is_known_have_no_share() -> None:
    seen = sweep((car(10, 3), (5.0, 0.0)))
    some = np.arange(len(seen.xyz_m)) % 10
    mostly_unknown = np.where(some == 0, 1, np.where(some == 1, 0, -1)).astype(np.int8)  # half of the known
    walls = replace(seen, background=mostly_unknown)
    assert len(found(walls, max_background_share=0.4).seven) == 0
    assert len(found(walls, max_background_share=0.6).seven) == 1
    unknown = replace(seen, background=np.full(len(some), -1, np.int8))
    assert len(found(unknown, max_background_share=0.0).seven) == 1


def test_what_stays_where_it_is_is_no_mover() -> None:
    points, time_s = car(10, 3), np.arange(21) * 0.1
    seen = replace(sweep((points, (6.0, 0.0))), step=10)
    stays = places(time_s, [points for _ in time_s])
    assert len(found(seen, stays).seven) == 0
    goes = places(time_s, [points + [6.0 * (t - 1.0), 0, 0] for t in time_s])
    assert len(found(seen, goes).seven) == 1


def test_few_points_are_noise() -> None:
    boxes = found(sweep((car(10, 3)[:4], (5.0, 0.0))))
    assert len(boxes.seven) == 0
    assert (boxes.of_point == NOISE).all()


def test_an_empty_sweep() -> None:
    boxes = found(sweep())
    assert boxes.seven.shape == (0, 7)
    assert boxes.of_point.shape == (0,)


def test_background_that_makes_no_cluster_joins_what_it_lies_in() -> None:
    seen = sweep((car(10, 3), (5.0, 0.0)))
    side = seen.xyz_m[:, 0] > 9.0  # the side of the car is taken for a wall
    walls = replace(seen, background=side.astype(np.int8))
    kept = found(walls, cluster_background=False, max_background_share=1.0)
    assert len(kept.seven) == 1
    assert kept.seven[0, 3] < 1.5  # its back alone makes the box
    assert (found(walls, cluster_background=True).seven[0, 3]) > 3.5


def test_neighbours_that_look_unlike_are_two_objects() -> None:
    seen = sweep((np.concatenate([car(10, 3), car(14.2, 3)]), (0.0, 0.0)))
    seen = replace(seen, candidate=np.ones(len(seen.xyz_m), bool))
    assert len(found(seen).seven) == 1
    unlike = np.repeat([0.0, 3.0], len(seen.xyz_m) // 2)[:, None]
    assert len(found(replace(seen, look=unlike)).seven) == 2


def test_a_roof_above_its_windows_is_of_the_same_car() -> None:
    body = car(10, 3)
    points = body[(body[:, 2] < 0.6) | (body[:, 2] > 1.2)]
    assert len(found(sweep((points, (5.0, 0.0))), eps_m=0.6).seven) == 1
