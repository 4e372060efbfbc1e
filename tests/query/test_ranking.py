"""The ranking of a search, against the plain formula."""

from __future__ import annotations

import numpy as np
import pytest
from stored import basis, model

from upvl_cli.query.index import Objects
from upvl_cli.query.ranking import Ranking
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.types import Floats, Ints

WORDS = ("bus", "fire truck", "car", "tree", "road")


def vocabulary(queried: int) -> Vocabulary:
    vectors = model().embed_text(WORDS)
    classes = np.maximum(np.arange(len(WORDS)) - queried + 1, 0)
    return Vocabulary(("asked",), WORDS, classes, vectors)


def objects(boxes: int) -> Objects:
    """Boxes with random features; some have no points, some no looks, and none has neither."""
    rng = np.random.default_rng(0)
    zeros, kind = np.zeros(boxes), np.arange(boxes) % 3
    return Objects(
        frame=zeros, box=zeros, track_id=zeros, time_s=zeros, confidence=zeros, num_features=5 * (kind != 0),
        center_m=np.zeros((boxes, 3)), size_lwh_m=np.ones((boxes, 3)), heading_rad=zeros,
        velocity_mps=np.zeros((boxes, 3)), pooled=rng.integers(-127, 128, (boxes, 64)), num_looks=2 * (kind != 1),
        look_feature=rng.integers(-127, 128, (boxes, 64)),
    )  # fmt: skip


def plain(codes: Ints, words: Vocabulary) -> Floats:
    cosines, asked = basis().cosines(codes, words.vectors), words.is_queried
    best = cosines[:, asked].max(axis=1)
    return best if asked.all() else best - cosines[:, ~asked].max(axis=1)


@pytest.mark.parametrize("queried", [1, 2, len(WORDS)])
@pytest.mark.parametrize("cache_bytes", [0, 2**20])
@pytest.mark.parametrize("step", [1, 7])
def test_it_is_the_best_queried_word_less_the_best_negative(
    queried: int, cache_bytes: int, step: int
) -> None:
    boxes, words = objects(10_000), vocabulary(queried)
    ranking, rows = Ranking(basis(), cache_bytes), np.arange(0, 10_000, step)
    of_points, of_looks = plain(boxes.pooled, words), plain(boxes.look_feature, words)
    both = np.select(
        [boxes.num_looks == 0, boxes.num_features == 0],
        [of_points, of_looks],
        np.maximum(of_points, of_looks),
    )
    for _ in range(2):  # the second time from what was kept
        found = ranking.score("a", boxes, rows, words, uses_looks=True)
        np.testing.assert_allclose(found, both[rows], atol=2e-6)
        found = ranking.score("a", boxes, rows, words, uses_looks=False)
        np.testing.assert_allclose(found, of_points[rows], atol=2e-6)


def test_other_negatives_are_not_taken_for_those_that_were_kept() -> None:
    boxes, ranking, rows = objects(9), Ranking(basis(), 2**20), np.arange(9)
    for queried in (1, 2, 1):
        words = vocabulary(queried)
        found = ranking.score("a", boxes, rows, words, uses_looks=False)
        np.testing.assert_allclose(found, plain(boxes.pooled, words), atol=2e-6)


def test_no_boxes() -> None:
    assert len(Ranking(basis()).score("a", objects(0), np.arange(0), vocabulary(1), uses_looks=True)) == 0
