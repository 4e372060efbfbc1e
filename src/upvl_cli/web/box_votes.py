"""Which words the points of a box, and the looks at its track, are nearest to: why a hit has its score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import NotMade
from upvl_cli.perception.labels.look_votes import look_shares
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.types import Array
from upvl_cli.web.catalog import Catalog

MOST_WORDS = 4
_SHOWN_SHARE = 0.005  # less is printed as 0 %


@dataclass(frozen=True)
class WordVote:
    """What one word has of a box.

    Attributes:
        word: The word.
        is_queried: Whether it was asked for; else it competes.
        points: Share of the points that vote for it, 0 to 1.
        looks: Share that the looks at the track give it, 0 to 1.
    """

    word: str
    is_queried: bool
    points: float
    looks: float


def votes_of_box(
    catalog: Catalog, vocabulary: Vocabulary, segment: str, frame: int, box: int
) -> list[WordVote]:
    """Return the words with the largest shares of a box, largest first; none without points and looks.

    Args:
        catalog: The boxes.
        vocabulary: The words.
        segment: Name of the drive.
        frame: Index of the frame.
        box: Row of the box in its frame.
    """
    if catalog.store is None:
        raise NotMade(catalog.no_words)
    row, objects = catalog.row(segment, frame, box), catalog.objects(segment)
    by_points = np.zeros(len(vocabulary.words))
    by_looks = np.zeros(len(vocabulary.words))
    if objects.num_features[row]:
        features = catalog.point_features(segment)[frame].point_feature
        start = int(features.count[:box].sum())
        codes = features.values[start : start + int(features.count[box])]
        nearest = catalog.store.basis.cosines(codes, vocabulary.vectors).argmax(axis=1)
        by_points = np.bincount(nearest, minlength=len(by_points)) / max(len(nearest), 1)
    if objects.num_looks[row]:
        cosines = catalog.store.basis.cosines(objects.look_feature[row : row + 1], vocabulary.vectors)
        by_looks = look_shares(cosines, vocabulary.class_of_word, catalog.store.looks.temperature)[0]
    return _largest(vocabulary, by_points, by_looks, catalog.store.looks.weight)


def _largest(vocabulary: Vocabulary, by_points: Array, by_looks: Array, weight: float) -> list[WordVote]:
    has_points, has_looks = bool(by_points.any()), bool(by_looks.any())
    share = by_looks if not has_points else by_points
    if has_points and has_looks:
        share = (1 - weight) * by_points + weight * by_looks
    is_queried = vocabulary.is_queried
    order = [int(place) for place in np.argsort(-share, kind="stable") if share[place] >= _SHOWN_SHARE]
    return [
        WordVote(
            vocabulary.words[place], bool(is_queried[place]), float(by_points[place]), float(by_looks[place])
        )
        for place in order[:MOST_WORDS]
    ]
