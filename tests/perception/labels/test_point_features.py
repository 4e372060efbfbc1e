"""Which points speak for an object, and their mean feature."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.point_features import of_objects, pooled
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import NO_VIEW, OCCLUDED, SEEN

BASIS = Basis(np.zeros(8, np.float32), np.zeros((COMPONENTS, 8), np.float32), np.full(COMPONENTS, 0.5, np.float32), 1.0)


def test_background_and_what_is_not_seen_do_not_speak_for_an_object() -> None:
    state = np.array([SEEN, NO_VIEW, SEEN, OCCLUDED, SEEN, SEEN])
    background = np.array([1, 0, 0, 0, -1, 0], np.int8)
    point, feature = of_objects(state, np.array([[5], [6], [7], [8]]), background)
    assert point.tolist() == [2, 5]
    assert feature.tolist() == [[6], [8]]


def test_the_mean_of_each_box_and_nothing_where_no_point_is() -> None:
    codes = np.repeat(np.array([[10], [20], [-6]], np.int8), COMPONENTS, axis=1)
    got = pooled(np.array([0, 0, 2]), codes, 4, BASIS)
    assert got.dtype == np.int8
    assert got[:, 0].tolist() == [15, 0, -6, 0]


def test_no_box_at_all() -> None:
    assert pooled(np.zeros(0, np.int64), np.zeros((0, COMPONENTS), np.int8), 0, BASIS).shape == (0, COMPONENTS)
