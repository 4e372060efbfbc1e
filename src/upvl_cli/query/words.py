"""How words divide the stored boxes: which boxes each word wins, and which word would win them without it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import cosines_by_frame, point_features
from upvl_cli.query.index import indexed_objects
from upvl_cli.query.report import ambiguity_notes
from upvl_cli.query.run import check_segments, query_config
from upvl_cli.query.store import Store, open_store
from upvl_cli.query.vocabulary import Vocabulary, build_vocabulary
from upvl_cli.query.votes import vote
from upvl_cli.types import Array, Ints, Model
from upvl_cli.vlm.base import Explainer

CONCEPTS = 3  # shown of each word
BINS = 10
BARS = " ▁▂▃▄▅▆▇█"
NO_WORD = -1


@dataclass(frozen=True)
class WordStatistics:
    """What each of t words wins.

    Attributes:
        score_histogram: (t, BINS) boxes that each word wins, by score from 0 to 1.
        replacements: For each word, how many of its boxes each other word would win without it; `NO_WORD` where
            there is no other word.
    """

    score_histogram: Ints
    replacements: list[Counter[int]]


def word_statistics(store: Store, vocabulary: Vocabulary, filters: Filters) -> WordStatistics:
    """Let the points of all boxes vote, each word for itself, and again without each word.

    Args:
        store: The stored boxes.
        vocabulary: The words.
        filters: Which drives are considered.
    """
    total = len(vocabulary.words)
    histogram = np.zeros((total, BINS), dtype=np.int64)
    replacements: list[Counter[int]] = [Counter() for _ in range(total)]
    for segment, objects in indexed_objects(store):
        featured = objects[objects.num_features > 0]
        if not filters.includes(segment) or not len(featured):
            continue
        done = 0
        frames = cosines_by_frame(point_features(store, segment), store.basis, vocabulary, featured)
        for boxes, box_of_point, cosines in frames:
            votes = vote(cosines, box_of_point, boxes, np.arange(total))
            score = votes.share * featured.confidence[done : done + boxes]
            done += boxes
            bins = np.minimum(score * BINS, BINS - 1).astype(np.int64)
            np.add.at(histogram, (votes.word_index, bins), 1)
            for word in np.unique(votes.word_index).tolist():
                winner = _winner_without(cosines, box_of_point, boxes, word)
                replacements[word].update(winner[votes.word_index == word].tolist())
    return WordStatistics(histogram, replacements)


def _winner_without(cosines: Array, box_of_point: Ints, boxes: int, word: int) -> Ints:
    """Return (boxes,) the words that win without one of the words; `NO_WORD` where it is the only one."""
    others = np.delete(np.arange(cosines.shape[1]), word)
    if not len(others):
        return np.full(boxes, NO_WORD)
    return np.asarray(
        others[vote(cosines[:, others], box_of_point, boxes, np.arange(len(others))).word_index]
    )


def compare_words(
    workspace: Workspace,
    classes: Classes,
    source: str | None,
    segments: Collection[str],
    *,
    check_spelling: bool,
) -> Iterator[Table | str]:
    """Compare words with each other and with the default negatives; yield what is printed.

    Args:
        workspace: Holds the stored boxes, the model and the settings.
        classes: The words.
        source: "labels" or "detections"; None takes detections where there are any.
        segments: Names of the drives; an empty collection takes all.
        check_spelling: Whether a word that is likely misspelt is refused.

    Raises:
        BadSetting: A word is likely misspelt or has no vector, or a drive is unknown.
        NotMade: There is nothing to search yet.
    """
    config = query_config(workspace, {})
    vocabulary = build_vocabulary(workspace, classes, config, check_spelling=check_spelling)
    store = open_store(workspace, source)
    check_segments(workspace, store, segments)
    statistics = word_statistics(store, vocabulary, Filters(segments=segments))
    yield _table(vocabulary, statistics)
    yield (
        f"{statistics.score_histogram.sum()} {store.source} with features; a bar is a tenth of the score (share of "
        "the votes times confidence), from 0 to 1; (-) competes, and is not asked for"
    )
    yield from ambiguity_notes(vocabulary, workspace.model.name)
    yield from concept_notes(workspace.model, classes.all_words)


def concept_notes(model: Model, words: Sequence[str]) -> Iterator[str]:
    """Yield one line for each word: the nearest concepts that the pixels of the model were taught, if it can tell."""
    if isinstance(model, Explainer):
        for word, near in zip(words, model.nearest_concepts(words, CONCEPTS), strict=True):
            named = ", ".join(f"{name} {cosine:.2f}" for name, cosine in near)
            yield f'"{word}" to {model.name}: {named}'


def _table(vocabulary: Vocabulary, statistics: WordStatistics) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("word")
    table.add_column("boxes", justify="right")
    table.add_column("score 0..1", no_wrap=True)
    table.add_column("median", justify="right")
    table.add_column("without it they are")
    for word, (name, is_queried) in enumerate(zip(vocabulary.words, vocabulary.is_queried, strict=True)):
        histogram = statistics.score_histogram[word]
        boxes = int(histogram.sum())
        if boxes or is_queried:
            replacements = (
                f"{vocabulary.words[other] if other != NO_WORD else 'nothing'} {items}"
                for other, items in statistics.replacements[word].most_common(3)
            )
            shown = name if is_queried else f"(-) {name}"
            table.add_row(shown, str(boxes), _bars(histogram), _median(histogram), ", ".join(replacements))
    return table


def _bars(counts: Ints) -> str:
    heights = np.ceil(counts / max(int(counts.max()), 1) * (len(BARS) - 1)).astype(np.int64)
    return "".join(BARS[height] for height in heights)


def _median(counts: Ints) -> str:
    """Return the middle of the bin that holds the median."""
    if not counts.any():
        return ""
    return f"{(np.searchsorted(np.cumsum(counts), counts.sum() / 2) + 0.5) / BINS:.2f}"
