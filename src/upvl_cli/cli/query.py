"""Commands that ask for objects by words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.errors import BadSetting

On = Annotated[
    str | None,
    typer.Option(help="labels or detections; detections when left out and there are any.", metavar="WHAT"),
]
Anyway = Annotated[bool, typer.Option("--anyway", help="Ask for words that are likely misspelt as they are.")]


WIDE = 200  # columns where no terminal says how many there are: no name of a drive is cut


@app.command()
def query(
    context: typer.Context,
    phrases: Annotated[list[str] | None, typer.Argument(help='What to find: "fire truck".')] = None,
    classes: Annotated[
        Path | None, typer.Option(help="TOML file with classes of several words each, and negatives.")
    ] = None,
    on: On = None,
    moving: Annotated[
        bool | None, typer.Option("--moving/--parked", help="Only what moves, or only what does not.")
    ] = None,
    min_speed: Annotated[float | None, typer.Option(help="At least this fast (m/s).")] = None,
    max_speed: Annotated[float | None, typer.Option(help="At most this fast (m/s).")] = None,
    max_range: Annotated[float | None, typer.Option(help="At most this far from the car (m).")] = None,
    segment: Segments = None,
    from_s: Annotated[
        float | None, typer.Option("--from", help="Not before this time after the start of the drive (s).")
    ] = None,
    to_s: Annotated[
        float | None, typer.Option("--to", help="Not after this time after the start of the drive (s).")
    ] = None,
    min_score: Annotated[float | None, typer.Option(help="Least confidence of the box itself.")] = None,
    threshold: Annotated[
        float | None, typer.Option(help="Least score of a hit: share of the votes times confidence.")
    ] = None,
    top: Annotated[int | None, typer.Option(help="Lines of the table.")] = None,
    by: Annotated[str, typer.Option(help="vote of the points of a box, or its mean feature: mean.")] = "vote",
    search: Annotated[
        bool, typer.Option("--search", help="Rank all objects first, and ask only the most promising.")
    ] = False,
    sheet: Annotated[bool, typer.Option("--sheet/--no-sheet", help="Draw the hits.")] = True,
    anyway: Anyway = False,
) -> None:
    """Find objects by words: a table, out/query/*.parquet with all hits, and a picture of the best."""
    from upvl_cli.query.classes import of_file, of_phrases
    from upvl_cli.query.find import Filters
    from upvl_cli.query.run import Request
    from upvl_cli.query.run import query as answer

    if by not in ("vote", "mean"):
        raise BadSetting(f"--by {by}: expected vote or mean")
    if classes and phrases:
        raise BadSetting(
            "both phrases and --classes are given; put the phrases into the file, or leave it out"
        )
    filters = Filters(
        segments=segment or (),
        moving=moving,
        min_speed_mps=min_speed,
        max_speed_mps=max_speed,
        max_range_m=max_range,
        from_s=from_s,
        to_s=to_s,
        min_confidence=min_score,
    )
    given = {"threshold": threshold, "top": top}
    wanted = of_file(classes) if classes else of_phrases(phrases or [])
    request = Request(
        classes=wanted,
        name=classes.stem if classes else " ".join(wanted.words),
        on=on,
        filters=filters,
        by=by,
        search=search,
        sheet=sheet,
        anyway=anyway,
        values={name: value for name, value in given.items() if value is not None},
    )
    _print(answer(context.obj, request))


@app.command()
def words(
    context: typer.Context,
    listed: Annotated[str, typer.Argument(metavar="WORDS", help='The words: "car, fire truck, tram".')],
    on: On = None,
    segment: Segments = None,
    anyway: Anyway = False,
) -> None:
    """Show how objects fall to words, and to which other words they fall without each: to choose words."""
    from upvl_cli.query.classes import of_phrases
    from upvl_cli.query.words import compare

    _print(compare(context.obj, of_phrases([listed]), on, segment or (), anyway=anyway))


def _print(items: Iterable[Any]) -> None:
    from rich.console import Console

    width = None if Console().is_terminal else WIDE
    for item in items:
        Console(soft_wrap=isinstance(item, str), width=width).print(item, markup=False, highlight=False)
