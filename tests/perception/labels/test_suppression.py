"""Of two boxes on one object one stays, and what no object could fill goes."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.geometry.iou import iou_bev
from upvl_cli.perception.labels.suppression import support_score, suppress, wrong_size


def plain(seven: np.ndarray, score: np.ndarray, max_iou: float) -> np.ndarray:
    """The rule once more, box by box."""
    kept: list[int] = []
    for box in sorted(range(len(seven)), key=lambda row: (-score[row], row)):
        if all(iou_bev(seven[[box]], seven[[other]])[0, 0] <= max_iou for other in kept):
            kept.append(box)
    return np.isin(np.arange(len(seven)), kept)


def test_the_better_of_two_stays() -> None:
    car = [0.0, 0, 0, 4, 2, 1.5, 0]
    seven = np.array([car, [0.5, 0.1, 0, 4, 2, 1.5, 0.1], [10.0, 0, 0, 4, 2, 1.5, 0]])
    np.testing.assert_array_equal(
        suppress(seven, np.array([0.3, 0.8, 0.1]), max_iou=0.2), [False, True, True]
    )


def test_what_goes_takes_no_other_with_it() -> None:
    row = np.array([[x, 0.0, 0, 4, 2, 1.5, 0] for x in (0.0, 2.0, 4.0)])  # 1 overlaps 0 and 2, they touch
    kept = suppress(row, np.array([0.9, 0.8, 0.7]), max_iou=0.2)
    np.testing.assert_array_equal(kept, [True, False, True])


@pytest.mark.parametrize("seed", range(5))
def test_as_the_plain_rule(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seven = np.column_stack(
        [rng.uniform(0, 15, (60, 2)), np.zeros(60), np.full((60, 3), (4, 2, 1.5)), rng.uniform(-3, 3, 60)]
    )
    score = rng.integers(0, 10, 60) / 10
    np.testing.assert_array_equal(suppress(seven, score, max_iou=0.3), plain(seven, score, 0.3))


def test_nothing_stays_nothing() -> None:
    assert len(suppress(np.zeros((0, 7)), np.zeros(0), max_iou=0.2)) == 0
    assert support_score(np.zeros(0, int), np.zeros(0, int), np.zeros(0)).shape == (0,)


@pytest.mark.parametrize(
    ("size", "reason"),
    [
        ((4, 2, 1.5), None),
        ((30, 2.6, 2.5), None),  # 195 m^3: a tram
        ((0.5, 0.5, 1.7), None),  # a walker
        ((4, 2, 0.2), "too flat"),
        ((0.3, 0.3, 0.5), "too small"),
        ((20, 10, 3), "too large"),
    ],
)
def test_sizes(size: tuple[float, float, float], reason: str | None) -> None:
    faults = wrong_size(
        np.array([[0, 0, 0, *size, 0]]), min_volume_m3=0.1, max_volume_m3=200.0, min_height_m=0.3
    )
    assert [name for name, faulty in faults.items() if faulty[0]] == ([reason] if reason else [])


def test_more_support_is_a_higher_score_below_one() -> None:
    score = support_score(np.array([0, 10, 10, 1000]), np.array([50, 5, 50, 1000]), np.zeros(4))
    assert (np.diff(score) > 0).all()
    assert score[0] == 0
    assert score[-1] < 1


def test_background_lowers_the_score() -> None:
    score = support_score(np.full(3, 50), np.full(3, 10), np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(score, score[0] * np.array([1, 0.5, 0]))
