"""One query, from what was typed to what is printed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any

from rich.table import Table

from upvl_cli.config.toml import load
from upvl_cli.errors import NotMade
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query import report
from upvl_cli.query.classes import Classes
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.find import Filters, find
from upvl_cli.query.question import question
from upvl_cli.query.store import STAGE_OF, Store, store


@dataclass(frozen=True)
class Request:
    """What was typed.

    Attributes:
        classes: What is asked for.
        name: Of the files, but for the suffix.
        on: "labels" or "detections"; None takes detections where there are any.
        filters: Which objects count.
        by: "vote" of the points, or "mean" feature.
        search: Rank all objects first.
        sheet: Draw the hits.
        anyway: Take what is likely misspelt as it is.
        values: Settings over those of query.toml.
    """

    classes: Classes
    name: str
    on: str | None
    filters: Filters
    by: str
    search: bool
    sheet: bool
    anyway: bool
    values: dict[str, Any]


def query(workspace: Workspace, request: Request) -> Iterator[Table | str]:
    """Answer a query; yields what is to be printed.

    Raises:
        BadSetting: What is asked for is no word, or there is no such drive.
        NotMade: There is nothing to search yet.
    """
    settings = params(workspace, request.values)
    asked = question(workspace, request.classes, same=settings.same, anyway=request.anyway)
    where = store(workspace, request.on)
    check_segments(workspace, where, request.filters.segments)
    found = find(
        where,
        asked,
        replace(request.filters, moving_mps=settings.moving_mps),
        threshold=settings.threshold,
        by=request.by,
        candidates=settings.candidates if request.search else None,
    )
    if len(found.hits):
        yield report.table(found.hits, asked, settings.top)
    yield report.summary(found, where.on)
    yield from report.notes(asked, workspace.model.name)
    stem = workspace.out / "query" / report.slug(request.name)
    yield str(report.write(stem.with_name(f"{stem.name}.parquet"), found.hits, asked))
    if request.sheet and len(found.hits):
        from upvl_cli.query.sheet import draw

        yield str(draw(workspace, found.hits, asked, stem.with_name(f"{stem.name}.png")))


def params(workspace: Workspace, values: dict[str, Any]) -> QueryConfig:
    """The settings of query.toml, with values of the command line over them."""
    settings: QueryConfig = load(QueryConfig, workspace.stages / "query.toml", values)
    return settings


def check_segments(workspace: Workspace, where: Store, segments: Collection[str]) -> None:
    """Refuse a drive that is unknown, or has nothing to search.

    Raises:
        BadSetting: It is unknown.
        NotMade: It has not been worked on.
    """
    for name in segments:
        if name not in where.paths:
            workspace.check_name(name, workspace.segments)
            stage = STAGE_OF[where.on]
            raise NotMade(f"{name} has no {where.on} with features; run: upvl {stage} --segment {name}")
