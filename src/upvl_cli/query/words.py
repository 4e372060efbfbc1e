"""What words are worth on the drives at hand: which boxes each one wins, and what they would be without it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes
from upvl_cli.query.find import Filters, points_of, table_of_points
from upvl_cli.query.index import drives
from upvl_cli.query.question import Question, question
from upvl_cli.query.report import notes
from upvl_cli.query.run import check_segments, params
from upvl_cli.query.store import Store, store
from upvl_cli.query.votes import vote
from upvl_cli.types import Array, Ints

BINS = 10
BARS = " ▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class Worth:
    """What words are worth.

    Attributes:
        scores: (t, BINS) boxes that each word wins, by score from 0 to 1.
        instead: Of the boxes that it wins, what they would be without it: how many by each other word.
    """

    scores: Ints
    instead: list[Counter[int]]


def worth(store: Store, asked: Question, filters: Filters) -> Worth:
    """Let the points of all boxes vote, each word for itself, and again without each word.

    Args:
        store: Where the boxes are.
        asked: The words.
        filters: Which boxes count.
    """
    total = len(asked.words)
    scores = np.zeros((total, BINS), dtype=np.int64)
    instead: list[Counter[int]] = [Counter() for _ in range(total)]
    for name, objects in drives(store):
        if filters.segments and name not in filters.segments:
            continue
        of = objects[objects.points > 0]
        if not len(of):
            continue
        done = 0
        for boxes, of_box, cosines in points_of(table_of_points(store, name), store.basis, asked, of):
            answers = vote(cosines, of_box, boxes, np.arange(total))
            score = answers.share * of.confidence[done : done + boxes]
            done += boxes
            np.add.at(scores, (answers.word, np.minimum(score * BINS, BINS - 1).astype(np.int64)), 1)
            for word in np.unique(answers.word).tolist():
                without = _without(cosines, of_box, boxes, word)
                instead[word].update(without[answers.word == word].tolist())
    return Worth(scores, instead)


def _without(cosines: Array, of_box: Ints, boxes: int, word: int) -> Ints:
    """(boxes,) the words that win where one is not asked for; -1 where no other is there."""
    others = np.delete(np.arange(cosines.shape[1]), word)
    if not len(others):
        return np.full(boxes, -1)
    return np.asarray(others[vote(cosines[:, others], of_box, boxes, np.arange(len(others))).word])


def compare(
    workspace: Workspace, classes: Classes, on: str | None, segments: Collection[str], *, anyway: bool
) -> Iterator[Table | str]:
    """Compare words with each other, and with those that queries have them compete with; yields what is printed.

    Args:
        workspace: Where.
        classes: The words.
        on: "labels" or "detections"; None takes detections where there are any.
        segments: The drives; empty takes all.
        anyway: Take what is likely misspelt as it is.

    Raises:
        BadSetting: What is asked for is no word, or there is no such drive.
        NotMade: There is nothing to search yet.
    """
    asked = question(workspace, classes, same=params(workspace, {}).same, anyway=anyway)
    where = store(workspace, on)
    check_segments(workspace, where, segments)
    found = worth(where, asked, Filters(segments=segments))
    yield _table(asked, found)
    yield (
        f"{found.scores.sum()} {where.on} with features; a bar is a tenth of the score (share of the votes times "
        "confidence), from 0 to 1; (-) competes, and is not asked for"
    )
    yield from notes(asked, workspace.model.name)


def _table(asked: Question, found: Worth) -> Table:
    shown = Table(box=None, pad_edge=False)
    shown.add_column("word")
    shown.add_column("boxes", justify="right")
    shown.add_column("score 0..1", no_wrap=True)
    shown.add_column("median", justify="right")
    shown.add_column("without it they are")
    for word, (name, is_asked) in enumerate(zip(asked.words, asked.asked, strict=True)):
        boxes = int(found.scores[word].sum())
        if boxes or is_asked:
            others = (
                f"{asked.words[other] if other >= 0 else 'nothing'} {items}"
                for other, items in found.instead[word].most_common(3)
            )
            name = name if is_asked else f"(-) {name}"
            shown.add_row(
                name, str(boxes), _bars(found.scores[word]), _median(found.scores[word]), ", ".join(others)
            )
    return shown


def _bars(counts: Ints) -> str:
    heights = np.ceil(counts / max(int(counts.max()), 1) * (len(BARS) - 1)).astype(np.int64)
    return "".join(BARS[height] for height in heights)


def _median(counts: Ints) -> str:
    """Middle of the bin that holds the median."""
    if not counts.any():
        return ""
    return f"{(np.searchsorted(np.cumsum(counts), counts.sum() / 2) + 0.5) / BINS:.2f}"
