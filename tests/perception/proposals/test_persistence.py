"""A moving object leaves its place; what stays where it is does not move."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from proposal_scene import PERSISTENCE, all_candidates, block, car, history, proposals, sweep

from upvl_cli.perception.clustering import NOISE
from upvl_cli.perception.proposals.persistence import occupied_places, sliding_history

NOWHERE = np.zeros((0, 3))
TIMES_S = np.arange(-4, 5) * 0.5
NOW = 4  # the step of time 0
PLACE = np.array([[10.05, 3.05, 1.05]])


def occupied_at(points: np.ndarray, *times_s: float):  # noqa: ANN201
    """A history in which the points are there at these times alone."""
    is_there = [any(abs(time - other) < 0.01 for other in times_s) for time in TIMES_S]
    return history(TIMES_S, [points if there else NOWHERE for there in is_there])


def is_persistent(
    times_s: list[float], there: list[bool], step: int, span_s: float = 1.0, **values: float
) -> bool:
    """Whether a place is persistent that is occupied in some sweeps."""
    occupied = history(times_s, [PLACE if each else NOWHERE for each in there])
    return bool(occupied.is_persistent(step, span_s, PLACE, replace(PERSISTENCE, **values))[0])


@pytest.mark.parametrize(
    ("before", "after", "persistent"),
    [(True, True, True), (True, False, False), (False, True, False), (False, False, False)],
)
def test_a_place_is_persistent_that_is_occupied_before_and_after(
    before: bool, after: bool, persistent: bool
) -> None:
    assert is_persistent([0.0, 1.0, 2.0], [before, False, after], 1) == persistent


def test_at_the_ends_of_a_drive_the_other_side_decides() -> None:
    assert is_persistent([0.0, 1.0], [False, True], 0)
    assert not is_persistent([0.0, 1.0], [True, False], 0)
    assert is_persistent([0.0, 1.0], [True, False], 1)
    assert not is_persistent([0.0, 1.0], [False, True], 1)


def test_nothing_is_persistent_without_evidence() -> None:
    assert not is_persistent([0.0, 0.1], [True, True], 0)
    assert occupied_at(PLACE, 0.0).is_persistent(NOW, 1.0, NOWHERE, PERSISTENCE).shape == (0,)


@pytest.mark.parametrize(("time_s", "persistent"), [(0.77, True), (1.23, True), (0.73, False), (1.27, False)])
def test_a_sweep_stands_for_a_time_close_to_its_own(time_s: float, persistent: bool) -> None:
    assert is_persistent([0.0, time_s], [False, True], 0) == persistent


def test_the_tolerance_in_time_grows_with_the_span() -> None:
    assert is_persistent([0.0, 2.4], [False, True], 0, span_s=2.0)
    assert not is_persistent([0.0, 0.9], [False, True], 0, span_s=0.5)
    assert not is_persistent([0.0, 2.4], [False, True], 0, span_s=2.0, time_tolerance=0.1)


def test_the_nearest_sweep_in_time_is_asked() -> None:
    assert is_persistent([0.0, 0.8, 0.95, 1.2], [False, False, True, False], 0)


@pytest.mark.parametrize(("away_m", "persistent"), [(0.24, True), (0.26, False)])
def test_places_within_a_radius_are_the_same(away_m: float, persistent: bool) -> None:
    occupied = history([0.0, 1.0], [NOWHERE, PLACE])
    found = occupied.is_persistent(0, 1.0, PLACE + [0, away_m, 0], PERSISTENCE)
    assert found.tolist() == [persistent]


def test_what_stays_where_it_is_is_no_mover() -> None:
    points = car(10, 3)
    seen = replace(sweep((points, (6.0, 0.0))), step=NOW)
    stays = history(TIMES_S, [points for _ in TIMES_S])
    found = proposals(seen, stays)
    assert len(found.boxes) == 0
    assert found.dropped["persistent"] == 1
    assert found.dropped["persistent points"] == 0
    goes = history(TIMES_S, [points + [6.0 * t, 0, 0] for t in TIMES_S])
    assert len(proposals(seen, goes).boxes) == 1


@pytest.mark.parametrize(
    ("speed_mps", "span_s"),
    [
        (9.0, 0.5),  # its own length of 4 m and 0.3 m are behind it after 0.48 s
        (8.2, 1.0),  # after 0.52 s; its length alone after 0.49 s
        (4.4, 1.0),
        (4.2, 2.0),  # after 1.02 s; its length alone after 0.95 s
    ],
)
def test_an_object_is_looked_for_after_the_time_in_which_it_clears_its_place(
    speed_mps: float, span_s: float
) -> None:
    points = block(10, 3, (4, 2, 1.5), step_m=0.5)
    seen = replace(sweep((points, (speed_mps, 0.0))), step=NOW)
    for other_s in (0.5, 1.0, 2.0):
        occupied = occupied_at(points, -other_s, other_s)
        assert len(proposals(seen, occupied, box__trim=0.0).boxes) == (other_s != span_s)
        # The spans may stand in any order.
        reverse = proposals(seen, occupied, box__trim=0.0, persistence__spans_s=(2.0, 1.0, 0.5))
        assert len(reverse.boxes) == (other_s != span_s)


@pytest.mark.parametrize("velocity_mps", [(2.0, 0.0), (0.0, 0.0), (0.5, 0.0, 6.0)])
def test_an_object_too_slow_to_clear_its_place_is_no_doubt(velocity_mps: tuple[float, ...]) -> None:
    points = car(10, 3)
    seen = replace(all_candidates(sweep((points, velocity_mps))), step=NOW)
    stays = history(TIMES_S, [points for _ in TIMES_S])
    assert len(proposals(seen, stays).boxes) == 1


def test_points_that_stay_are_no_part_of_an_object_that_moves() -> None:
    mover, wall = block(10, 3, (4, 2, 1.5), step_m=0.25), block(13, 3, (1, 2, 1.5), step_m=0.25)
    seen = replace(sweep((np.concatenate([mover, wall]), (6.0, 0.0))), step=NOW)
    found = proposals(seen, occupied_at(wall + [0.05, 0, 0], -1.0, 1.0), box__trim=0.0)
    assert found.boxes.size_lwh_m[0, 0] == pytest.approx(4.0, abs=0.3)  # 5.5 with the wall
    assert set(found.box_of_point[-len(wall) :]) == {NOISE}
    assert found.dropped["persistent points"] >= len(wall)
    assert found.dropped["persistent"] == 0


def points_on_two_sides(stay: int, go: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of one cluster: some that stay, 1 m before those that go."""
    return np.tile([11.05, 3.05, 1.05], (stay, 1)), np.tile([10.05, 3.05, 1.05], (go, 1))


@pytest.mark.parametrize(
    ("stay", "go", "points"),
    [(8, 8, [8]), (9, 8, []), (5, 6, [6]), (5, 5, [])],  # half; more than half; 6 are enough; 5 too few
)
def test_the_share_of_persistent_points_decides_and_enough_others_are_left(
    stay: int, go: int, points: list[int]
) -> None:
    there, gone = points_on_two_sides(stay, go)
    seen = replace(sweep((np.concatenate([there, gone]), (6.0, 0.0))), step=NOW)
    found = proposals(seen, occupied_at(there, -0.5, 0.5), clustering__eps_m=(1.5,))
    assert found.num_points.tolist() == points
    assert found.dropped["persistent"] == (stay > go)
    assert found.dropped["too few points"] == (go < 6)


def test_places_are_compared_in_world_axes() -> None:
    points = car(10, 3)
    pose = np.array([[0.0, -1, 0, 100], [1, 0, 0, 50], [0, 0, 1, 2], [0, 0, 0, 1]])
    world = points @ pose[:3, :3].T + pose[:3, 3]
    seen = replace(sweep((points, (6.0, 0.0))), step=NOW, world_from_sweep=pose)
    assert len(proposals(seen, history(TIMES_S, [world for _ in TIMES_S])).boxes) == 0
    assert len(proposals(seen, history(TIMES_S, [points for _ in TIMES_S])).boxes) == 1


@pytest.mark.parametrize("tolerance", [0.0, 0.25])
def test_a_window_of_seconds_tells_what_the_whole_drive_tells(tolerance: float) -> None:
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.05, 0.6, 60))
    sweeps = [rng.uniform(0, 1, (4, 3)) for _ in time_s]
    whole, config = history(time_s, sweeps), replace(PERSISTENCE, time_tolerance=tolerance)
    asked = rng.uniform(0, 1, (20, 3))
    found = 0
    for step, (place, window) in enumerate(sliding_history(time_s, whole.trees, config)):
        assert window.time_s[place] == time_s[step]
        for span_s in config.spans_s:
            expected = whole.is_persistent(step, span_s, asked, config)
            np.testing.assert_array_equal(window.is_persistent(place, span_s, asked, config), expected)
            found += expected.sum()
    assert tolerance == 0 or found > 100


def test_only_the_sweeps_of_the_window_are_held() -> None:
    """2.5 s before and after at 10 Hz are 51 sweeps, of a drive of a minute too."""
    time_s, live, most = np.arange(600) * 0.1, weakref.WeakSet(), 0

    def places() -> Iterator[object]:
        for _ in time_s:
            tree = Places()
            live.add(tree)
            yield tree

    for _ in sliding_history(time_s, places(), PERSISTENCE):
        most = max(most, len(live))
    assert most <= 54


class Places:
    """A stand-in that can be referred to weakly."""


def test_no_sweep_has_no_window() -> None:
    assert list(sliding_history(np.zeros(0), [], PERSISTENCE)) == []
    assert occupied_places(NOWHERE, voxel_m=0.1).n == 0
