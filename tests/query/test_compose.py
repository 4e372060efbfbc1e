"""Relations of boxes whose places were chosen, so that gaps, passes and stops are known."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.query import compose
from upvl_cli.query.compose import TimedBoxes, gap_m, near, overtakings, stops
from upvl_cli.types import Boxes, concat


def boxes(
    xy: list[tuple[float, float]],
    *,
    object_id: int,
    velocity: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float] = (4.0, 2.0),
    heading: float = 0.0,
    first_frame: int = 0,
) -> TimedBoxes:
    """One object at these places, a frame a second."""
    frames, n = first_frame + np.arange(len(xy)), len(xy)
    return TimedBoxes(
        center_m=np.column_stack([np.array(xy).reshape(-1, 2), np.zeros(n)]),
        size_lwh_m=np.tile([*size, 1.5], (n, 1)),
        heading_rad=np.full(n, heading),
        frame=frames,
        time_s=frames.astype(float),
        object_id=np.full(n, object_id),
        velocity_mps=np.tile([*velocity, 0.0], (n, 1)),
    )


NOTHING = boxes([], object_id=0)


@pytest.mark.parametrize(
    ("second", "expected"),
    [
        (([7.0, 0.0], [4.0, 2.0], 0.0), 3.0),  # in a row: 7 m less two half lengths
        (([0.0, 6.0], [4.0, 2.0], 0.0), 4.0),  # side by side: 6 m less two half widths
        (([7.0, 6.0], [4.0, 2.0], 0.0), 5.0),  # corner to corner: 3 and 4
        (([3.0, 0.0], [4.0, 2.0], 0.0), 0.0),  # overlapping
        (([0.0, 0.0], [2.0, 8.0], 0.0), 0.0),  # a cross: no corner lies inside the other
        (([6.0, 0.0], [4.0, 2.0], np.pi / 2), 3.0),  # turned: 6 m less half a length and half a width
        (([2 + 3 + np.sqrt(2), 0.0], [2.0, 2.0], np.pi / 4), 3.0),  # a corner faces a side
    ],
)
def test_the_gap_between_footprints(second: tuple[list[float], list[float], float], expected: float) -> None:
    first = Boxes([[0, 0, 0]], [[4, 2, 1.5]], [0.0])
    (x, y), (length, width), heading = second
    other = Boxes([[x, y, 5.0]], [[length, width, 1.5]], [heading])
    np.testing.assert_allclose(gap_m(first, other), [expected], atol=1e-9)
    np.testing.assert_allclose(gap_m(other, first), [expected], atol=1e-9)


def test_near_takes_the_nearest_of_the_same_frame() -> None:
    walker = boxes([(0, 0), (0, 0)], object_id=1, size=(0.5, 0.5))
    others = concat(
        [
            boxes([(8, 0)], object_id=2),  # frame 0: gap of 8 - 0.25 - 2
            boxes([(0, 4)], object_id=3),  # frame 0: gap of 4 - 0.25 - 1
            boxes([(1, 0)], object_id=4, first_frame=7),  # another frame
        ],
        TimedBoxes,
    )
    found = near(walker, others, 5.0)
    assert (found.first.tolist(), found.second.tolist()) == ([0], [1])
    np.testing.assert_allclose(found.value, [2.75])
    assert len(near(walker, others, 2.7)) == 0


def test_an_object_is_not_near_itself() -> None:
    car = boxes([(0, 0)], object_id=1)
    assert len(near(car, car, 5.0)) == 0
    assert len(near(car, boxes([(0, 0)], object_id=2), 5.0)) == 1


def test_many_pairs_are_compared_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    first, second = (
        concat(
            [boxes([tuple(rng.uniform(-30, 30, 2)) for _ in range(9)], object_id=k) for k in numbers],
            TimedBoxes,
        )
        for numbers in (range(8), range(8, 20))
    )
    at_once = near(first, second, 6.0)
    monkeypatch.setattr(compose, "_MOST_PAIRS", 10)
    in_parts = near(first, second, 6.0)
    assert len(at_once) > 5
    np.testing.assert_array_equal(in_parts.first, at_once.first)
    np.testing.assert_array_equal(in_parts.second, at_once.second)


def test_nothing_is_near_nothing() -> None:
    car = boxes([(0, 0)], object_id=1)
    for first, second in ((NOTHING, NOTHING), (car, NOTHING), (NOTHING, car)):
        assert len(near(first, second, 5.0)) == 0
        assert len(overtakings(first, second, max_lateral_m=5.0, moving_mps=1.0)) == 0
    assert len(stops(NOTHING, min_stand_s=1.0, moving_mps=1.0)) == 0


def passing(
    *,
    lateral_m: float = 3.0,
    fast: tuple[float, float] = (15.0, 0.0),
    slow: tuple[float, float] = (10.0, 0.0),
) -> tuple[TimedBoxes, TimedBoxes]:
    """One gains 5 m a second on another that starts 12 m ahead; both as seen from a car that keeps its distance."""
    passes = boxes([(-12 + 5 * t, lateral_m) for t in range(6)], object_id=1, velocity=fast)
    other = boxes([(0, 0)] * 6, object_id=2, velocity=slow)
    return passes, other


def found_overtakings(first: TimedBoxes, second: TimedBoxes) -> list[tuple[int, int, float]]:
    found = overtakings(first, second, max_lateral_m=5.0, moving_mps=1.0)
    return list(zip(found.first.tolist(), found.second.tolist(), found.value.tolist(), strict=True))


def test_the_faster_overtakes_the_slower() -> None:
    fast, slow = passing()
    # 2 m behind at 2 s, 3 m ahead at 3 s.
    assert found_overtakings(fast, slow) == [(3, 3, 1.0)]
    assert found_overtakings(slow, fast) == []


def test_a_direction_across_the_car_counts_as_well() -> None:
    fast, slow = passing(lateral_m=-3.0)
    turned = [
        TimedBoxes(
            center_m=car.center_m[:, [1, 0, 2]],
            size_lwh_m=car.size_lwh_m,
            heading_rad=car.heading_rad + np.pi / 2,
            frame=car.frame,
            time_s=car.time_s,
            object_id=car.object_id,
            velocity_mps=car.velocity_mps[:, [1, 0, 2]],
        )
        for car in (fast, slow)
    ]
    assert found_overtakings(*turned) == [(3, 3, 1.0)]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"lateral_m": 9.0}, "a lane too far"),
        ({"slow": (0.0, 0.0)}, "passing what is parked is no overtaking"),
        ({"slow": (-10.0, 0.0)}, "the other comes the other way"),
        ({"slow": (0.0, 10.0)}, "the other crosses"),
        ({"fast": (0.5, 0.0)}, "it does not move itself"),
        ({"fast": (9.0, 12.0)}, "it turns away: 53 degrees"),
    ],
)
def test_what_is_no_overtaking(changes: dict[str, object], why: str) -> None:
    assert found_overtakings(*passing(**changes)) == [], why


def test_side_by_side_is_no_overtaking() -> None:
    wobbling = boxes([(x, 3.0) for x in (-0.5, 0.5, -0.4, 0.6)], object_id=1, velocity=(10, 0))
    other = boxes([(0, 0)] * 4, object_id=2, velocity=(10, 0))
    assert found_overtakings(wobbling, other) == []


def drive_and_stand(*speeds: float, object_id: int = 1) -> TimedBoxes:
    parts = [
        boxes([(0, 0)], object_id=object_id, velocity=(speed, 0), first_frame=second)
        for second, speed in enumerate(speeds)
    ]
    return concat(parts, TimedBoxes)


@pytest.mark.parametrize(
    ("speeds", "expected"),
    [
        ((5, 5, 0, 0, 0, 0), [(2, 3.0)]),  # stands from 2 s to 5 s
        ((5, 0, 0, 5, 0, 0, 0, 5), [(4, 2.0)]),  # the first stop is too short
        ((0, 0, 0, 0), []),  # it was never seen moving
        ((5, 5, 5), []),
        ((5, 1, 1, 1), []),  # as fast as a moving box
        ((), []),
    ],
)
def test_stops(speeds: tuple[float, ...], expected: list[tuple[int, float]]) -> None:
    found = stops(drive_and_stand(*speeds), min_stand_s=2.0, moving_mps=1.0)
    assert list(zip(found.first.tolist(), found.value.tolist(), strict=True)) == expected


def test_a_standing_object_does_not_take_the_motion_of_another() -> None:
    both = concat(
        [drive_and_stand(5, 5, 5, object_id=1), drive_and_stand(0, 0, 0, 0, object_id=2)], TimedBoxes
    )
    assert len(stops(both, min_stand_s=1.0, moving_mps=1.0)) == 0
    shuffled = np.random.default_rng(0).permutation(7)
    assert len(stops(both[shuffled], min_stand_s=1.0, moving_mps=1.0)) == 0
