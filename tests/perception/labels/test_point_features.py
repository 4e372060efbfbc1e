"""Which points speak for an object, and their mean feature."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.point_features import average_pool, foreground_points
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import NO_VIEW, OCCLUDED, SEEN
from upvl_cli.types import Ragged

STEP = np.linspace(0.1, 0.5, COMPONENTS, dtype=np.float32)
BASIS = Basis(np.zeros(8, np.float32), np.zeros((COMPONENTS, 8), np.float32), STEP, 1.0)


def test_background_and_what_is_not_seen_do_not_speak_for_an_object() -> None:
    state = np.array([SEEN, NO_VIEW, SEEN, OCCLUDED, SEEN, SEEN])
    background = np.array([1, 0, 0, 0, -1, 0], np.int8)
    point, feature = foreground_points(state, np.array([[5], [6], [7], [8]]), background)
    assert point.tolist() == [2, 5]
    assert feature.tolist() == [[6], [8]]


def test_the_mean_of_each_box_and_nothing_where_no_point_is() -> None:
    codes = np.repeat(np.array([[10], [20], [-6]], np.int8), COMPONENTS, axis=1)
    pooled = average_pool(Ragged(codes, np.array([2, 0, 1, 0])), BASIS)
    assert pooled.dtype == np.int8
    assert pooled.shape == (4, COMPONENTS)
    for component in (0, COMPONENTS - 1):  # each component by its own step
        assert pooled[:, component].tolist() == [15, 0, -6, 0]


def test_a_mean_is_rounded_to_the_nearest_code() -> None:
    codes = np.repeat(np.array([[1], [1], [2], [-1], [-1], [-2]], np.int8), COMPONENTS, axis=1)
    pooled = average_pool(Ragged(codes, np.array([3, 3])), BASIS)
    assert pooled[:, 0].tolist() == [1, -1]


def test_no_box_at_all() -> None:
    none = Ragged(np.zeros((0, COMPONENTS), np.int8), np.zeros(0, np.int64))
    assert average_pool(none, BASIS).shape == (0, COMPONENTS)
