"""Answers to questions, computed once each: by words, by filters alone, by likeness, and by a relation of two."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import Classes, classes_from_phrases
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import WarmStore, find, hits_of_one_class
from upvl_cli.query.index import Objects
from upvl_cli.query.kinds import with_kinds
from upvl_cli.query.ranking import Ranking
from upvl_cli.query.report import ambiguity_notes, best_of_tracks
from upvl_cli.query.run import query_config
from upvl_cli.query.vocabulary import Vocabulary, build_vocabulary
from upvl_cli.runtime.bounded_cache import BoundedCache
from upvl_cli.stages import classify
from upvl_cli.types import Bools
from upvl_cli.web.answer import Answer, best_boxes_of_tracks, by_score, plain_vocabulary
from upvl_cli.web.catalog import Catalog, Catalogs
from upvl_cli.web.parameters import Question
from upvl_cli.web.relations import related

_ANSWERS = 128
_MOST_BROWSED = 20_000  # tracks of an answer without words: more than anybody pages through


@dataclass(frozen=True)
class SearchResult:
    """An answer, and what it was looked for in."""

    catalog: Catalog
    answer: Answer


class Search:
    """Answers questions about a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        """Name the workspace."""
        self.workspace = workspace
        self.catalogs = Catalogs(workspace)
        self._answers: BoundedCache[Answer] = BoundedCache(_ANSWERS)
        self._vocabularies: BoundedCache[Vocabulary] = BoundedCache(_ANSWERS)
        self._config = query_config(workspace, {})

    def ask(self, question: Question) -> SearchResult:
        """Return the answer.

        Raises:
            BadSetting: A word is misspelt, or a drive or box is unknown.
            NotMade: There is nothing to search, or nothing that words can be compared with.
        """
        catalog = self.catalogs.get(question.source)
        key = (catalog.source, catalog.digest, question)
        return SearchResult(catalog, self._answers.get_or_make(key, lambda: self._compute(catalog, question)))

    def _compute(self, catalog: Catalog, question: Question) -> Answer:
        for name in question.segments:
            catalog.objects(name)
        answer = self._plain(catalog, question)
        if question.relation:
            threshold = self._config.threshold
            partners = answer
            if question.relation != "stopped":
                other = Question(
                    question.source, question.other, anyway=question.anyway, segments=question.segments,
                    candidates=question.candidates,
                )  # fmt: skip
                partners = self.ask(other).answer
                partners = replace(partners, hits=partners.hits[: partners.above(threshold)])
            answer = related(catalog, answer, partners, question, self._moving_mps)
        return answer

    def _plain(self, catalog: Catalog, question: Question) -> Answer:
        """Return the answer without the relation."""
        if question.similar_to:
            return self._similar(catalog, question)
        if question.words:
            return self._by_words(catalog, question)
        return self._by_filters(catalog, question)

    @property
    def _moving_mps(self) -> float:
        return self._config.moving_mps

    def _by_words(self, catalog: Catalog, question: Question) -> Answer:
        if catalog.no_words or catalog.store is None:
            raise NotMade(
                f"words cannot be asked: {catalog.no_words}; leave the words out to search by filters"
            )
        config = replace(self._config, search=True, candidates=question.candidates, threshold=0.0)
        vocabulary = self.vocabulary(question)
        warm = catalog.warm
        if question.class_name:
            # Other boxes than those whose cosines are kept.
            warm = WarmStore(self._of_class(catalog, question), warm.tables, Ranking(catalog.store.basis))
        result = find(catalog.store, vocabulary, _filters(question), config, warm)
        best, _ = best_of_tracks(result.hits)
        notes = tuple(ambiguity_notes(vocabulary, self.workspace.model.name))
        threshold = self._config.threshold
        hits = result.hits[np.sort(best)]
        return Answer(hits, vocabulary, "votes", result.counts, notes, threshold=threshold)

    def vocabulary(self, question: Question) -> Vocabulary:
        """Return the words of a question and their negatives, embedded."""
        key = (question.words, question.negatives, question.anyway)
        return self._vocabularies.get_or_make(key, lambda: self._embed(question))

    def _embed(self, question: Question) -> Vocabulary:
        classes = classes_from_phrases([", ".join(question.words)])
        if question.negatives:
            repeated = set(question.words) & set(question.negatives)
            if repeated:
                raise BadSetting(f"{min(repeated)!r} is asked for and left out at once; name it in one field")
            classes = Classes(classes.words, question.negatives)
        classes = with_kinds(classes, self.workspace.settings(classify.STAGE))
        return build_vocabulary(self.workspace, classes, self._config, check_spelling=not question.anyway)

    def _by_filters(self, catalog: Catalog, question: Question) -> Answer:
        counts: Counter[str] = Counter()
        parts = []
        for segment, objects, passes in self._passing(catalog, question):
            rows = np.flatnonzero(passes)
            counts.update(
                {"boxes": len(objects), "filtered out": len(objects) - len(rows), "hits": len(rows)}
            )
            best = rows[best_boxes_of_tracks(objects.track_id[rows], objects.confidence[rows])]
            parts.append(hits_of_one_class(segment, objects[best], objects.confidence[best]))
        hits = by_score(parts)
        return Answer(hits[:_MOST_BROWSED], plain_vocabulary(), "confidence", counts)

    def _similar(self, catalog: Catalog, question: Question) -> Answer:
        if catalog.store is None or not question.similar_to:
            raise NotMade(f"boxes cannot be compared: {catalog.no_words}")
        segment, frame, box = question.similar_to
        objects, basis = catalog.objects(segment), catalog.store.basis
        row = catalog.row(segment, frame, box)
        uses_looks = objects.num_features[row] == 0
        if uses_looks and objects.num_looks[row] == 0:
            raise BadSetting(
                f"box {box} of frame {frame} of {segment} has no feature: no camera shows it; choose another hit"
            )
        codes = (objects.look_feature if uses_looks else objects.pooled)[row : row + 1]
        vector = basis.mean + basis.dequantize(codes) @ basis.components
        vector /= max(float(np.linalg.norm(vector)), 1e-9)
        counts: Counter[str] = Counter()
        parts = []
        for name, others, passes in self._passing(catalog, question):
            passes &= (others.num_looks if uses_looks else others.num_features) > 0
            if name == segment:
                same = others.track_id == objects.track_id[row] if objects.track_id[row] >= 0 else False
                passes &= ~(same | ((others.frame == frame) & (others.box == box)))
            rows = np.flatnonzero(passes)
            counts.update({"boxes": len(others), "filtered out": len(others) - len(rows), "hits": len(rows)})
            features = others.look_feature if uses_looks else others.pooled
            cosine = basis.cosines(features if len(rows) == len(others) else features[rows], vector)[:, 0]
            best = best_boxes_of_tracks(others.track_id[rows], cosine)
            parts.append(hits_of_one_class(name, others[rows[best]], cosine[best]))
        hits = by_score(parts)[: question.candidates]
        return Answer(hits, plain_vocabulary(), "similarity", counts)

    def _passing(self, catalog: Catalog, question: Question) -> Iterator[tuple[str, Objects, Bools]]:
        """Yield for each drive its name, its boxes, and which of them pass the filters."""
        filters = _filters(question)
        for segment, objects in catalog.drives.items():
            if filters.includes(segment):
                passes = filters.mask(objects, self._moving_mps)
                if question.class_name:
                    passes &= catalog.names(segment).class_name == question.class_name
                yield segment, objects, passes

    def _of_class(self, catalog: Catalog, question: Question) -> Mapping[str, Objects]:
        """Return the boxes of all drives of the class that is asked for."""
        return {
            segment: objects[catalog.names(segment).class_name == question.class_name]
            for segment, objects in catalog.drives.items()
        }


def _filters(question: Question) -> Filters:
    return Filters(
        segments=question.segments,
        moving={"": None, "moving": True, "parked": False}[question.motion],
        min_speed_mps=question.min_speed,
        max_speed_mps=question.max_speed,
        max_range_m=question.max_range,
        from_s=question.from_s,
        to_s=question.to_s,
        min_confidence=question.min_score,
    )
