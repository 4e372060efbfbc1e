"""What the page of results shows: the form, the number of hits, their histogram, and one page of cards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import parse_qsl

from markupsafe import Markup

from upvl_cli.query.find import Hits
from upvl_cli.web.answer import Answer
from upvl_cli.web.box_votes import WordVote, votes_of_box
from upvl_cli.web.catalog import Catalog, Catalogs
from upvl_cli.web.charts import histogram
from upvl_cli.web.parameters import CANDIDATES, CLASSES, MOTIONS, PER_PAGE, RELATIONS, Asked, encode
from upvl_cli.web.search import SearchResult

MOST_DRIVES = 500  # of the list to choose from
SCORE_NAMES = {
    "votes": "share of the votes times the score of the box",
    "confidence": "score of the box itself",
    "similarity": "cosine of the features",
}


@dataclass(frozen=True)
class Card:
    """One hit as the page shows it; pictures are asked for by its `place`, an address without its beginning."""

    place: str
    title: str
    drive: str
    frame: int
    track: int
    score: float
    confidence: float
    share: float | None
    time_s: float
    range_m: float
    speed_mps: float
    remark: str
    votes: Sequence[WordVote]
    similar: str


def form(catalogs: Catalogs, catalog: Catalog | None, asked: Asked) -> dict[str, Any]:
    """Return what the form shows: the values of the question, and what can be chosen.

    Args:
        catalogs: The sources that there are.
        catalog: What the question is asked of; None where there is nothing to search.
        asked: The question.
    """
    drives = list(catalog.drives) if catalog else []
    return {
        "question": asked.question,
        "words": ", ".join(asked.question.words),
        "negatives": ", ".join(asked.question.negatives),
        "other": ", ".join(asked.question.other),
        "sources": catalogs.sources(),
        "source": catalog.source if catalog else "",
        "drives": drives[:MOST_DRIVES],
        "drives_total": len(drives),
        "classes": [name for name in CLASSES if name] if catalog and catalog.has_classes else [],
        "motions": [name for name in MOTIONS if name],
        "relations": [name for name in RELATIONS if name],
        "candidates": CANDIDATES,
        "no_words": catalog.no_words if catalog else "",
        "total": catalog.total if catalog else 0,
        "is_narrowed": is_narrowed(asked),
    }


def is_narrowed(asked: Asked) -> bool:
    """Return whether a field of the filters is set, so that the page opens them."""
    question = asked.question
    plain = replace(
        question, words=(), source="", anyway=False, similar_to=(), candidates=CANDIDATES[0], segments=()
    )
    return plain != type(question)() or bool(question.segments)


def results(found: SearchResult, asked: Asked) -> dict[str, Any]:
    """Return what the page shows of an answer.

    Args:
        found: The answer.
        asked: The question, its threshold and its page.
    """
    answer = found.answer
    threshold = answer.threshold if asked.threshold is None else asked.threshold
    total = answer.above(threshold)
    pages = max(1, -(-total // PER_PAGE))
    page = min(asked.page, pages)
    begin = (page - 1) * PER_PAGE
    cards = [_card(found, asked, place) for place in range(begin, min(begin + PER_PAGE, total))]
    return {
        "hits": total,
        "classified": len(answer.hits),
        "best_below": float(answer.hits.score.max(initial=0)) if not total else 0.0,
        "cards": cards,
        "page": page,
        "pages": pages,
        "previous": asked.address(page=page - 1) if page > 1 else "",
        "next": asked.address(page=page + 1) if page < pages else "",
        "threshold": threshold,
        "chart": Markup(histogram(answer.histogram, threshold)),
        "kept_fields": parse_qsl(encode(replace(asked, threshold=None, page=1))),
        "score_name": SCORE_NAMES[answer.kind],
        "counts": [(reason, items) for reason, items in answer.counts.items() if items and reason != "hits"],
        "notes": answer.notes,
        "download": encode(replace(asked, threshold=threshold, page=1)),
        "address": encode(asked),
        "similar_to": asked.question.similar_to,
        "version": version(found.catalog),
    }


def version(catalog: Catalog) -> str:
    """Return a short text that changes with the shards, for the addresses of pictures."""
    import hashlib

    return hashlib.sha256(catalog.digest.encode()).hexdigest()[:12]


def _card(found: SearchResult, asked: Asked, place: int) -> Card:
    answer, catalog, hits = found.answer, found.catalog, found.answer.hits
    segment, frame, box = str(hits.segment[place]), int(hits.frame[place]), int(hits.box[place])
    return Card(
        place=f"{catalog.source}/{segment}/{frame}/{box}",
        title=_title(catalog, answer, place),
        drive=segment,
        frame=frame,
        track=int(hits.track_id[place]),
        score=float(hits.score[place]),
        confidence=float(hits.confidence[place]),
        share=float(hits.share[place]) if answer.kind == "votes" else None,
        time_s=float(hits.time_s[place]),
        range_m=range_m(hits, place),
        speed_mps=speed_mps(hits, place),
        remark=answer.remarks[place] if answer.remarks else "",
        votes=votes(catalog, answer, segment, frame, box),
        similar=encode(
            Asked(replace(type(asked.question)(), source=catalog.source, similar_to=(segment, frame, box)))
        ),
    )


def votes(catalog: Catalog, answer: Answer, segment: str, frame: int, box: int) -> Sequence[WordVote]:
    """Return the words of a box; none where no words were asked for."""
    return votes_of_box(catalog, answer.vocabulary, segment, frame, box) if answer.kind == "votes" else ()


def _title(catalog: Catalog, answer: Answer, place: int) -> str:
    hits = answer.hits
    if answer.kind == "votes":
        return answer.vocabulary.words[int(hits.word_index[place])]
    segment = str(hits.segment[place])
    row = catalog.row(segment, int(hits.frame[place]), int(hits.box[place]))
    names = catalog.names(segment)
    return str(names.word[row] or names.class_name[row] or "object")


def range_m(hits: Hits, place: int) -> float:
    """Return the horizontal distance of a hit from the car."""
    return float((hits.center_m[place, :2] ** 2).sum() ** 0.5)


def speed_mps(hits: Hits, place: int) -> float:
    """Return the horizontal speed of a hit over the ground."""
    return float((hits.velocity_mps[place, :2] ** 2).sum() ** 0.5)
