"""Finds what is asked for: filters, perhaps a ranking of all objects, then the vote of the points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.tables import Table
from upvl_cli.query.index import Objects, drives, joined
from upvl_cli.query.question import Question
from upvl_cli.query.store import Store
from upvl_cli.query.votes import NONE, Answers, first_of_each, rank, vote
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import PointFeatureRow
from upvl_cli.types import Array, Bools, Floats, Ints, ParallelArrays, array


@dataclass(frozen=True)
class Filters:
    """Which objects count, whatever they are; None sets no bound.

    Attributes:
        segments: The drives; empty takes all.
        moving: Moving or parked ones only.
        moving_mps: Moving is what is at least this fast.
        min_speed_mps: Bound of the speed over the ground.
        max_speed_mps: The other bound.
        max_range_m: Bound of the distance from the car.
        from_s: Bound of the time since the start of the drive.
        to_s: The other bound.
        min_confidence: Bound of the confidence of the box.
    """

    segments: Collection[str] = ()
    moving: bool | None = None
    moving_mps: float = 0.0
    min_speed_mps: float | None = None
    max_speed_mps: float | None = None
    max_range_m: float | None = None
    from_s: float | None = None
    to_s: float | None = None
    min_confidence: float | None = None

    def keep(self, objects: Objects) -> Bools:
        """(n,) which of them pass."""
        speed, kept = objects.speed_mps, np.ones(len(objects), dtype=np.bool_)
        if self.moving is not None:
            kept &= (speed >= self.moving_mps) == self.moving
        for values, least, most in (
            (speed, self.min_speed_mps, self.max_speed_mps),
            (objects.range_m, None, self.max_range_m),
            (objects.time_s, self.from_s, self.to_s),
            (objects.confidence, self.min_confidence, None),
        ):
            kept &= True if least is None else values >= least
            kept &= True if most is None else values <= most
        return kept


@dataclass(frozen=True)
class Hits(ParallelArrays):
    """Boxes that are what was asked for, best first.

    Attributes:
        segment: (n,) name of the drive.
        frame: (n,) index of the frame.
        box: (n,) place of the box in its frame.
        track_id: (n,) number of the track, -1 for none.
        time_s: (n,) since the first frame of the drive.
        seven: (n, 7) the box, in ego axes.
        velocity_mps: (n, 3) over the ground along the ego axes.
        confidence: (n,) of the box itself, 0 to 1.
        points: (n,) points with a feature in the box.
        kind: (n,) number of the class.
        word: (n,) number of the word.
        share: (n,) share of the votes that the class has.
        cosine: (n,) mean cosine of the votes for the class.
        score: (n,) share times confidence.
    """

    segment: Array = array("str")
    frame: Array = array("int64")
    box: Array = array("int32")
    track_id: Array = array("int64")
    time_s: Array = array("float64")
    seven: Array = array("float32", 7)
    velocity_mps: Array = array("float32", 3)
    confidence: Array = array("float32")
    points: Array = array("int32")
    kind: Array = array("int32")
    word: Array = array("int32")
    share: Array = array("float32")
    cosine: Array = array("float32")
    score: Array = array("float32")


@dataclass(frozen=True)
class Found:
    """What a query found, and what became of all other stored boxes."""

    hits: Hits
    counts: Counter[str]


def find(
    store: Store,
    question: Question,
    filters: Filters,
    *,
    threshold: float,
    by: str = "vote",
    candidates: int | None = None,
) -> Found:
    """Ask all stored objects.

    Args:
        store: Where they are.
        question: What is asked.
        filters: Which of them count.
        threshold: A hit has at least this score.
        by: "vote" of the points, or "mean" feature of the box.
        candidates: Rank by mean feature first, and ask only so many, one box a track; None asks all.

    Raises:
        BadInput: No stored object has any feature.
    """
    counts: Counter[str] = Counter()
    parts = []
    for name, objects, answers in answered(store, question, filters, by, candidates, counts):
        score = answers.share * objects.confidence
        asked = (answers.kind != NONE) & (answers.kind < len(question.names))
        hit = asked & (score >= threshold)
        counts["other words"] += int((answers.kind != NONE).sum() - asked.sum())
        counts["below the threshold"] += int((asked & (score < threshold)).sum())
        counts["hits"] += int(hit.sum())
        parts.append(_hits(name, objects, answers, hit))
    hits = joined(Hits, parts)
    return Found(hits[np.lexsort((hits.box, hits.frame, hits.segment, -hits.cosine, -hits.score))], counts)


def _hits(name: str, objects: Objects, answers: Answers, hit: Bools) -> Hits:
    of = objects[hit]
    share = answers.share[hit]
    return Hits(
        segment=np.full(len(of), name),
        frame=of.frame,
        box=of.box,
        track_id=of.track_id,
        time_s=of.time_s,
        seven=of.seven,
        velocity_mps=of.velocity_mps,
        confidence=of.confidence,
        points=of.points,
        kind=answers.kind[hit],
        word=answers.word[hit],
        share=share,
        cosine=answers.cosine[hit],
        score=share * of.confidence,
    )


Kept = list[tuple[str, Objects, Ints]]


def answered(
    store: Store,
    question: Question,
    filters: Filters,
    by: str,
    candidates: int | None,
    counts: Counter[str],
) -> Iterator[tuple[str, Objects, Answers]]:
    """The objects of each drive that count and have features, with what they are; see `find`."""
    kept: Kept = []
    featured = 0
    for name, objects in drives(store):
        counts["boxes"] += len(objects)
        featured += int((objects.points > 0).sum())
        if filters.segments and name not in filters.segments:
            counts["other drives"] += len(objects)
            continue
        keep = filters.keep(objects)
        counts["filtered out"] += int((~keep).sum())
        counts["without points"] += int((keep & (objects.points == 0)).sum())
        kept.append((name, objects, np.flatnonzero(keep & (objects.points > 0))))
    if counts["boxes"] and not featured:
        raise BadInput(
            f"none of the {store.on} has a feature, for no camera was used; run: upvl autolabel --all-motion"
        )
    if candidates is not None:
        total = sum(len(places) for *_, places in kept)
        kept = _promising(store, question, kept, candidates)
        counts["not ranked high enough"] += total - sum(len(places) for *_, places in kept)
    ask = _by_points if by == "vote" else _by_mean
    asked = [(name, objects[places]) for name, objects, places in kept if len(places)]
    for (name, objects), answers in zip(asked, ask(store, question, asked), strict=True):
        yield name, objects, answers


def _promising(store: Store, question: Question, kept: Kept, candidates: int) -> Kept:
    """The best box of each of the best tracks of all drives, by mean feature."""

    def ranked(of: tuple[str, Objects, Ints]) -> Floats:
        _, objects, places = of
        return rank(store.basis.cosines(objects.pooled[places], question.vectors), question.asked)

    none = np.zeros(0, dtype=np.int64)
    score: list[Array] = [none, *in_order(ranked, kept)]
    group: list[Array] = [none]
    drive: list[Array] = [none]
    for number, (_, objects, places) in enumerate(kept):
        track = objects.track_id[places]
        group.append(np.where(track < 0, -1, track * len(kept) + number))
        drive.append(np.full(len(places), number))
    best = first_of_each(np.concatenate(score), np.concatenate(group), candidates)
    of_drive, place = (
        np.concatenate(drive)[best],
        np.concatenate([none, *(places for *_, places in kept)])[best],
    )
    return [
        (name, objects, np.sort(place[of_drive == number])) for number, (name, objects, _) in enumerate(kept)
    ]


def _by_mean(store: Store, question: Question, asked: Sequence[tuple[str, Objects]]) -> Iterator[Answers]:
    for _, objects in asked:
        cosines = store.basis.cosines(objects.pooled, question.vectors)
        yield vote(cosines, np.arange(len(objects)), len(objects), question.kind_of_word)


def _by_points(store: Store, question: Question, asked: Sequence[tuple[str, Objects]]) -> Iterator[Answers]:
    opened = in_order(lambda of: table_of_points(store, of[0]), asked)
    for table, (_, objects) in zip(opened, asked, strict=True):
        parts = [
            vote(cosines, of_box, boxes, question.kind_of_word)
            for boxes, of_box, cosines in points_of(table, store.basis, question, objects)
        ]
        fields = ("kind", "word", "share", "cosine")
        yield Answers(*(np.concatenate([getattr(part, field) for part in parts]) for field in fields))


def table_of_points(store: Store, name: str) -> Table[PointFeatureRow]:
    """The points of the boxes of a drive, by frame."""
    return Table(store.paths[name], PointFeatureRow)


def points_of(
    table: Table[PointFeatureRow], basis: Basis, question: Question, objects: Objects
) -> Iterator[tuple[int, Ints, Array]]:
    """Of the objects of a drive, frame by frame: how many, the object of each point, its cosines with all words."""

    def of_frame(of: tuple[int, Ints]) -> tuple[int, Ints, Array]:
        frame, boxes = of
        features = table[frame].point_feature
        of_box = np.searchsorted(boxes, features.owner)
        inside = boxes[np.minimum(of_box, len(boxes) - 1)] == features.owner
        return len(boxes), of_box[inside], basis.cosines(features.values[inside], question.vectors)

    frames, first = np.unique(objects.frame, return_index=True)
    return in_order(of_frame, zip(frames.tolist(), np.split(objects.box, first[1:]), strict=True))
