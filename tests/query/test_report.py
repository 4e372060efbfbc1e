"""The table of hits, by hand."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from upvl_cli.query.find import Hits
from upvl_cli.query.report import best_of_tracks, hit_table
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.query.words import _bars, _median

# Best first: two boxes of track 1, the same number in another drive and in another class, two without a track.
COLUMNS = {
    "segment": ["b", "a", "b", "b", "a", "a", "a"],
    "track_id": [1, 1, 1, 1, -1, -1, 0],
    "class_index": [0, 0, 0, 1, 0, 0, 0],
}


def hits() -> Hits:
    values = {spec.name: np.zeros((7, *spec.metadata["shape"])) for spec in fields(Hits)}
    return Hits(**{**values, **{name: np.array(column) for name, column in COLUMNS.items()}})


def test_a_track_is_of_one_drive_and_one_class() -> None:
    best, count = best_of_tracks(hits())
    assert best.tolist() == [0, 1, 3, 4, 5, 6]
    assert count.tolist() == [2, 1, 1, 1, 1, 1]


def test_the_table_has_a_line_a_track() -> None:
    vocabulary = Vocabulary(("car", "bus"), ("car", "bus", "tree"), np.arange(3), np.eye(3))
    assert [hit_table(hits(), vocabulary, top).row_count for top in (1, 4, 20)] == [1, 4, 6]
    assert hit_table(hits(), vocabulary, 1).columns[0].header == "word"
    two_words = Vocabulary(("car", "bus"), ("car", "van", "bus"), np.array([0, 0, 1]), np.eye(3))
    assert [column.header for column in hit_table(hits(), two_words, 1).columns][:2] == ["class", "word"]


def test_histograms_of_words() -> None:
    counts = np.array([0, 1, 0, 0, 4, 0, 0, 0, 0, 8])
    assert _bars(counts) == " ▁  ▄    █"
    assert _median(counts) == "0.95"
    assert _median(np.array([3, 1, 0, 0, 0, 0, 0, 0, 0, 0])) == "0.05"
    assert _median(np.zeros(10, int)) == ""
