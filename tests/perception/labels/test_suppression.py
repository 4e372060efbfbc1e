"""Scores of labels by their support, and sizes that no object has."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.labels.config import SizeConfig, SupportScoreConfig
from upvl_cli.perception.labels.suppression import size_faults, support_score
from upvl_cli.types import Boxes

SCORE = SupportScoreConfig(half_points=15.0, half_frames=4.0)
SIZE = SizeConfig(min_volume_m3=0.1, max_volume_m3=200.0, min_height_m=0.3)


@pytest.mark.parametrize(
    ("size", "reason"),
    [
        ((4, 2, 1.5), None),
        ((30, 2.6, 2.5), None),  # 195 m^3: a tram
        ((0.5, 0.5, 1.7), None),  # a walker
        ((4, 2, 0.2), "too flat"),
        ((0.3, 0.3, 0.5), "too small"),
        ((20, 10, 3), "too large"),
        ((0.1, 0.1, 0.1), "too flat"),  # and too small: one reason is enough
        ((4, 2, 0.3), None),  # the limits themselves
        ((0.5, 0.4, 0.5), None),
        ((10, 10, 2), None),
        ((np.nan, 2, 1.5), "too small"),
        ((4, 2, np.nan), "too flat"),
    ],
)
def test_sizes(size: tuple[float, float, float], reason: str | None) -> None:
    faults = size_faults(Boxes(np.zeros((1, 3)), np.array([size]), np.zeros(1)), SIZE)
    assert [name for name, faulty in faults.items() if faulty[0]] == ([reason] if reason else [])


def test_more_support_is_a_higher_score_below_one() -> None:
    score = support_score(np.array([0, 10, 10, 1000]), np.array([50, 5, 50, 1000]), np.zeros(4), SCORE)
    assert (np.diff(score) > 0).all()
    assert score[0] == 0
    assert score[-1] < 1


def test_each_part_of_the_support_is_one_half_at_its_setting() -> None:
    points, frames = np.array([15, 15, 10**9]), np.array([4, 10**9, 4])
    np.testing.assert_allclose(support_score(points, frames, np.zeros(3), SCORE), [0.25, 0.5, 0.5])
    np.testing.assert_allclose(support_score(np.array([45]), np.array([12]), np.zeros(1), SCORE), [9 / 16])


def test_background_lowers_the_score() -> None:
    score = support_score(np.full(3, 50), np.full(3, 10), np.array([0.0, 0.5, 1.0]), SCORE)
    np.testing.assert_allclose(score, score[0] * np.array([1, 0.5, 0]))


def test_no_box_has_no_score() -> None:
    assert support_score(np.zeros(0, int), np.zeros(0, int), np.zeros(0), SCORE).shape == (0,)
