"""One query, from the request to what is printed."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.table import Table

from upvl_cli.config.toml import load
from upvl_cli.errors import NotMade
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query import report
from upvl_cli.query.classes import Classes
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.filters import Filters
from upvl_cli.query.find import QueryResult, find
from upvl_cli.query.kinds import with_kinds
from upvl_cli.query.near import near_hits
from upvl_cli.query.store import STAGE_OF, Store, open_store
from upvl_cli.query.vocabulary import Vocabulary, build_vocabulary
from upvl_cli.stages import classify

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Near:
    """Other objects, and how far from one of them a hit may be in the same frame.

    Attributes:
        classes: The words of the other objects.
        within_m: Largest gap between the footprints.
    """

    classes: Classes
    within_m: float


@dataclass(frozen=True)
class Request:
    """What a user asks for.

    Attributes:
        classes: The queried classes.
        name: Name of the files that are written, without suffix.
        source: "labels" or "detections"; None takes detections where there are any.
        filters: Which boxes are considered.
        sheet: Whether a picture of the best hits is drawn.
        check_spelling: Whether a word that is likely misspelt is refused.
        values: Settings that replace those of query.toml.
        near: What a hit must be near; None for anything.
    """

    classes: Classes
    name: str
    source: str | None
    filters: Filters
    sheet: bool
    check_spelling: bool
    values: Mapping[str, Any]
    near: Near | None = None


@dataclass(frozen=True)
class QueryAnswer:
    """What a query found.

    Attributes:
        result: The hits, best first, and how many boxes had which fate.
        vocabulary: Names the classes and words of the hits.
        source: "labels" or "detections": what was searched.
        config: The settings of the query.
    """

    result: QueryResult
    vocabulary: Vocabulary
    source: str
    config: QueryConfig


def answer(workspace: Workspace, request: Request) -> QueryAnswer:
    """Return what a query finds; nothing is written.

    Raises:
        BadSetting: A word is likely misspelt or has no vector, or a drive is unknown.
        NotMade: There is nothing to search yet.
    """
    config = query_config(workspace, request.values)

    def vocabulary_of(classes: Classes) -> Vocabulary:
        kinds = with_kinds(classes, workspace.settings(classify.STAGE))
        return build_vocabulary(workspace, kinds, config, check_spelling=request.check_spelling)

    vocabulary = vocabulary_of(request.classes)
    store = open_store(workspace, request.source)
    check_segments(workspace, store, request.filters.segments)
    result = find(store, vocabulary, request.filters, config)
    if request.near is not None:
        everywhere = Filters(segments=request.filters.segments)
        partners = find(store, vocabulary_of(request.near.classes), everywhere, config).hits
        result = near_hits(result, partners, request.near.within_m)
    return QueryAnswer(result, vocabulary, store.source, config)


def query(workspace: Workspace, request: Request) -> Iterator[Table | str]:
    """Answer a query, write its hits and draw the best; yield what is to be printed.

    Raises:
        BadSetting: A word is likely misspelt or has no vector, or a drive is unknown.
        NotMade: There is nothing to search yet.
    """
    found = answer(workspace, request)
    hits, vocabulary = found.result.hits, found.vocabulary
    if len(hits):
        yield report.hit_table(hits, vocabulary, found.config.top)
    yield report.summary(found.result, found.source)
    yield from report.ambiguity_notes(vocabulary, workspace.model.name)
    stem = workspace.out / "query" / report.slug(request.name)
    yield str(report.write_hits(stem.with_name(f"{stem.name}.parquet"), hits, vocabulary))
    if request.sheet and len(hits):
        from upvl_cli.query.sheet import draw_sheet

        path = stem.with_name(f"{stem.name}.png")
        yield str(draw_sheet(workspace, hits, vocabulary, found.config.sheet_objects, path))


def all_hits(workspace: Workspace, request: Request) -> pa.Table:
    """Return all hits of a query, best first, with one row a box; errors as of `answer`."""
    found = answer(workspace, request)
    return report.hits_as_table(found.result.hits, found.vocabulary)


def query_config(workspace: Workspace, values: Mapping[str, Any]) -> QueryConfig:
    """Return the settings of query.toml, with values of the command line over them."""
    return load(QueryConfig, workspace.stages / "query.toml", values)


def check_segments(workspace: Workspace, store: Store, segments: Collection[str]) -> None:
    """Check that each named drive has boxes to search.

    Raises:
        BadSetting: A drive is unknown.
        NotMade: A drive has not been processed yet.
    """
    for name in segments:
        if name not in store.paths:
            workspace.check_name(name, workspace.segments)
            stage = STAGE_OF[store.source]
            raise NotMade(f"{name} has no {store.source} with features; run: upvl {stage} --segment {name}")
