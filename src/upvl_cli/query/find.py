"""Find the boxes that a query asks for: filters, an optional ranking of all objects, then points and looks vote."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.pipeline.tables import Table
from upvl_cli.query.candidates import Candidates, OpenTable, shares_of_looks, vote_at_once
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.filters import Filters
from upvl_cli.query.index import Objects, open_index
from upvl_cli.query.ranking import Ranking
from upvl_cli.query.store import Store
from upvl_cli.query.vector_search import Vectors, narrow, open_vectors
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.query.votes import NO_CLASS, VoteResult, best_of_groups, vote
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import PointFeatureRow
from upvl_cli.types import Array, Bools, Floats, Ints, ParallelArrays, array, concat


@dataclass(frozen=True)
class Hits(ParallelArrays):
    """Boxes of a queried class, best first, in single precision.

    Attributes:
        segment: (n,) name of the drive.
        frame: (n,) index of the frame.
        box: (n,) row of the box in its frame.
        track_id: (n,) number of the track, -1 for none.
        time_s: (n,) time since the first frame of the drive.
        center_m: (n, 3) centre, in ego axes.
        size_lwh_m: (n, 3) length, width and height.
        heading_rad: (n,) direction of the length, in ego axes.
        velocity_mps: (n, 3) velocity over the ground along the ego axes.
        confidence: (n,) score of the box itself, 0 to 1.
        num_features: (n,) points of the box that have a feature.
        class_index: (n,) number of the class in the vocabulary.
        word_index: (n,) number of the word in the vocabulary.
        share: (n,) share of the votes that the class has.
        cosine: (n,) mean cosine of the votes for the class.
        score: (n,) share times confidence.
    """

    segment: Array = array("str")
    frame: Array = array("int64")
    box: Array = array("int32")
    track_id: Array = array("int64")
    time_s: Array = array("float64")
    center_m: Array = array("float32", 3)
    size_lwh_m: Array = array("float32", 3)
    heading_rad: Array = array("float32")
    velocity_mps: Array = array("float32", 3)
    confidence: Array = array("float32")
    num_features: Array = array("int32")
    class_index: Array = array("int32")
    word_index: Array = array("int32")
    share: Array = array("float32")
    cosine: Array = array("float32")
    score: Array = array("float32")


@dataclass(frozen=True)
class QueryResult:
    """What a query finds.

    Attributes:
        hits: The hits, best first.
        counts: How many boxes there were in all ("boxes") and of each fate, "hits" among them.
        ranking: How a search ranked the boxes: exactly, or by the files of `upvl index`; "" without a ranking.
    """

    hits: Hits
    counts: Counter[str]
    ranking: str = ""


@dataclass(frozen=True)
class WarmStore:
    """What a process that answers many queries keeps open.

    Attributes:
        drives: The boxes of each drive.
        tables: Gives the features of the points of a drive.
        ranking: Ranks boxes, and keeps what the next query needs as well.
        vectors: The files of `upvl index` that fit the boxes.
        release: Gives back the memory of the features of a drive that was ranked.
    """

    drives: Mapping[str, Objects]
    tables: OpenTable
    ranking: Ranking
    vectors: Vectors = field(default_factory=Vectors)
    release: Callable[[str], None] = lambda segment: None


def find(
    store: Store,
    vocabulary: Vocabulary,
    filters: Filters,
    config: QueryConfig,
    warm: WarmStore | None = None,
) -> QueryResult:
    """Return the boxes whose class is queried and whose score reaches the threshold, best first.

    Args:
        store: The stored boxes.
        vocabulary: The queried words and the negatives.
        filters: Which boxes are considered.
        config: How they are classified, and the threshold.
        warm: The boxes to search, where they are open already; None opens the index of the store.

    Raises:
        BadInput: No stored box has any feature.
    """
    counts: Counter[str] = Counter()
    parts = []
    if warm is None:
        warm = open_warm_store(store, config)
    considered = _considered(store, warm, filters, config, counts)
    candidates, ranking = _candidates(warm, store.basis, vocabulary, considered, config)
    if config.search:
        counts["not ranked high enough"] += _total(considered) - _total(candidates)
    classified = _classify(store, vocabulary, candidates, config, warm.tables)
    for chosen, votes in zip(candidates, classified, strict=True):
        objects = chosen.objects[chosen.rows]
        score = votes.share * objects.confidence
        is_queried = (votes.class_index != NO_CLASS) & (votes.class_index < len(vocabulary.class_names))
        hit = is_queried & (score >= config.threshold)
        counts["other words"] += int((votes.class_index != NO_CLASS).sum() - is_queried.sum())
        counts["below the threshold"] += int((is_queried & (score < config.threshold)).sum())
        counts["hits"] += int(hit.sum())
        parts.append(_hits(chosen.segment, objects, votes, hit))
    return QueryResult(best_first(concat(parts, Hits)), counts, ranking)


def open_warm_store(store: Store, config: QueryConfig) -> WarmStore:
    """Return the boxes of a store, as a search takes them; errors as of `open_index`.

    Args:
        store: The stored boxes.
        config: Says whether boxes will be searched.
    """
    index = open_index(store)
    vectors = open_vectors(store, index.drives, index.digests) if config.search else Vectors()
    return WarmStore(
        index.drives,
        lambda segment: point_features(store, segment),
        Ranking(store.basis),
        vectors,
        index.release_features,
    )


def best_first(hits: Hits) -> Hits:
    """Return the hits by descending score, then descending cosine, then drive, frame and row."""
    return hits[np.lexsort((hits.box, hits.frame, hits.segment, -hits.cosine, -hits.score))]


def _hits(segment: str, objects: Objects, votes: VoteResult, hit: Bools) -> Hits:
    boxes, share = objects[hit], votes.share[hit]
    found = hits_of_one_class(segment, boxes, share * boxes.confidence)
    classes = {"class_index": votes.class_index[hit], "word_index": votes.word_index[hit]}
    return replace(found, **classes, share=share, cosine=votes.cosine[hit])


def hits_of_one_class(segment: str, boxes: Objects, score: Floats) -> Hits:
    """Return boxes of a drive as hits of the first class, without shares and cosines.

    Args:
        segment: Name of the drive.
        boxes: n boxes.
        score: (n,) their scores.
    """
    zeros = np.zeros(len(boxes))
    return Hits(
        segment=np.full(len(boxes), segment),
        frame=boxes.frame,
        box=boxes.box,
        track_id=boxes.track_id,
        time_s=boxes.time_s,
        center_m=boxes.center_m,
        size_lwh_m=boxes.size_lwh_m,
        heading_rad=boxes.heading_rad,
        velocity_mps=boxes.velocity_mps,
        confidence=boxes.confidence,
        num_features=boxes.num_features,
        class_index=zeros,
        word_index=zeros,
        share=zeros,
        cosine=zeros,
        score=score,
    )


def _considered(
    store: Store, warm: WarmStore, filters: Filters, config: QueryConfig, counts: Counter[str]
) -> list[Candidates]:
    """Return the boxes with features that pass the filters, by drive; `counts` grows by the rest."""
    candidates: list[Candidates] = []
    featured = 0
    for segment, objects in warm.drives.items():
        counts["boxes"] += len(objects)
        # A box whose points no camera sees in this frame may be of a track that others show well.
        has_features = (objects.num_features > 0) | (_uses_looks(config) & (objects.num_looks > 0))
        featured += int(np.count_nonzero(has_features))
        if not filters.includes(segment):
            counts["other drives"] += len(objects)
            continue
        passes = filters.mask(objects, config.moving_mps)
        rows = np.flatnonzero(passes & has_features)
        passing = int(np.count_nonzero(passes))
        counts["filtered out"] += len(objects) - passing
        counts["without points"] += passing - len(rows)
        candidates.append(Candidates(segment, objects, rows))
    if counts["boxes"] and not featured:
        raise BadInput(
            f"none of the {store.source} has a feature, for no picture was used; where they are of moving objects "
            "alone, run: upvl autolabel --all-motion; else the pictures were not found: run: upvl check"
        )
    return candidates


def _candidates(
    warm: WarmStore,
    basis: Basis,
    vocabulary: Vocabulary,
    candidates: list[Candidates],
    config: QueryConfig,
) -> tuple[list[Candidates], str]:
    """Return the boxes to classify, by drive, without drives that have none, and how they were ranked."""
    how = ""
    if config.search:
        how = "ranked exactly"
        known = warm.vectors.drives
        by_index = sum(len(chosen.rows) for chosen in candidates if chosen.segment in known)
        if known and by_index >= config.index_min_boxes:
            rest = _total(candidates) - by_index
            how = f"{by_index} ranked by the index" + (f", {rest} exactly" if rest else "")
            candidates = narrow(
                warm.vectors,
                basis,
                vocabulary,
                candidates,
                tracks=config.candidates,
                uses_looks=_uses_looks(config),
            )
        candidates = _best_ranked(warm, vocabulary, candidates, config)
    return [chosen for chosen in candidates if len(chosen.rows)], how


def _total(candidates: Sequence[Candidates]) -> int:
    return sum(len(chosen.rows) for chosen in candidates)


def _best_ranked(
    warm: WarmStore, vocabulary: Vocabulary, candidates: Sequence[Candidates], config: QueryConfig
) -> list[Candidates]:
    """Return the best box of each of the best tracks of all drives, ranked by mean feature or by their looks."""

    def ranked(chosen: Candidates) -> Floats:
        score = warm.ranking.score(
            chosen.segment, chosen.objects, chosen.rows, vocabulary, uses_looks=_uses_looks(config)
        )
        warm.release(chosen.segment)
        return score

    if not candidates:
        return []
    score = np.concatenate(list(in_order(ranked, candidates)))
    rows = np.concatenate([chosen.rows for chosen in candidates])
    drive = np.repeat(np.arange(len(candidates)), [len(chosen.rows) for chosen in candidates])
    track = np.concatenate([chosen.objects.track_id[chosen.rows] for chosen in candidates])
    # Track numbers are those of a drive: two drives share none.
    group = np.where(track < 0, -1, track * len(candidates) + drive)
    best = best_of_groups(score, group, config.candidates)
    return [
        Candidates(chosen.segment, chosen.objects, np.sort(rows[best][drive[best] == number]))
        for number, chosen in enumerate(candidates)
    ]


def _classify(
    store: Store,
    vocabulary: Vocabulary,
    candidates: Sequence[Candidates],
    config: QueryConfig,
    open_table: OpenTable,
) -> Iterator[VoteResult]:
    """Yield the classes of the boxes of each drive."""
    if config.by == "mean":
        for chosen in candidates:
            cosines = store.basis.cosines(chosen.objects.pooled[chosen.rows], vocabulary.vectors)
            total = len(chosen.rows)
            yield vote(cosines, np.arange(total), total, vocabulary.class_of_word)
        return
    if config.search:
        yield from vote_at_once(store, vocabulary, candidates, open_table)
        return
    tables = in_order(lambda chosen: open_table(chosen.segment), candidates)
    for table, chosen in zip(tables, candidates, strict=True):
        objects, done, frames = chosen.objects[chosen.rows], 0, []
        for boxes, box_of_point, cosines in cosines_by_frame(table, store.basis, vocabulary, objects):
            looks = shares_of_looks(store, vocabulary, objects[done : done + boxes])
            frames.append(vote(cosines, box_of_point, boxes, vocabulary.class_of_word, looks))
            done += boxes
        names = ("class_index", "word_index", "share", "cosine")
        yield VoteResult(*(np.concatenate([getattr(frame, name) for frame in frames]) for name in names))


def _uses_looks(config: QueryConfig) -> bool:
    return config.by == "vote"


def point_features(store: Store, segment: str) -> Table[PointFeatureRow]:
    """Return the features of the points of the boxes of a drive, by frame."""
    return Table(store.paths[segment], PointFeatureRow)


def cosines_by_frame(
    table: Table[PointFeatureRow], basis: Basis, vocabulary: Vocabulary, objects: Objects
) -> Iterator[tuple[int, Ints, Array]]:
    """Yield, for each frame of some boxes of a drive, the cosines of their points with all words.

    Args:
        table: The features of the points of the drive.
        basis: Their basis.
        vocabulary: The t words.
        objects: The boxes, ascending by frame and row.

    Yields:
        How many boxes of the frame are asked for; (n,) the box of each of their points, numbered within the frame's
        boxes; (n, t) the cosines.
    """

    def cosines_of_frame(frame_and_boxes: tuple[int, Ints]) -> tuple[int, Ints, Array]:
        frame, boxes = frame_and_boxes
        features = table[frame].point_feature
        box_of_point = np.searchsorted(boxes, features.owner)
        inside = boxes[np.minimum(box_of_point, len(boxes) - 1)] == features.owner
        return len(boxes), box_of_point[inside], basis.cosines(features.values[inside], vocabulary.vectors)

    frames, first = np.unique(objects.frame, return_index=True)
    return in_order(cosines_of_frame, zip(frames.tolist(), np.split(objects.box, first[1:]), strict=True))
