"""Commands that find objects by words."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.cli.filter_options import FromS, MaxRange, MaxSpeed, MinScore, MinSpeed, Moving, ToS
from upvl_cli.errors import BadSetting

On = Annotated[
    str | None,
    typer.Option(
        help="Which boxes are searched. labels: the auto labels; detections: the boxes of the trained detector. "
        "Without this option detections are searched where there are any, else labels.",
        metavar="labels|detections",
    ),
]
Anyway = Annotated[
    bool, typer.Option("--anyway", help="Accept words that are likely misspelt, as they are written.")
]


WIDE = 200  # columns where no terminal says how many there are: no name of a drive is cut


@app.command()
def query(
    context: typer.Context,
    phrases: Annotated[
        list[str] | None,
        typer.Argument(help='Phrases to find, such as "fire truck"; commas separate several.'),
    ] = None,
    classes: Annotated[
        Path | None,
        typer.Option(help="TOML file of classes with several words each, and optional negatives."),
    ] = None,
    on: On = None,
    moving: Moving = None,
    min_speed: MinSpeed = None,
    max_speed: MaxSpeed = None,
    max_range: MaxRange = None,
    segment: Segments = None,
    from_s: FromS = None,
    to_s: ToS = None,
    min_score: MinScore = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            help="Minimum score of a hit, from 0 to 1: the share of the votes times the confidence of the box."
        ),
    ] = None,
    top: Annotated[int | None, typer.Option(help="Maximum number of lines in the table.")] = None,
    by: Annotated[
        str | None,
        typer.Option(
            help="What classifies a box. vote: each of its points votes for the nearest word; mean: the mean feature "
            "of the box is compared with the words.",
            metavar="vote|mean",
        ),
    ] = None,
    search: Annotated[
        bool | None,
        typer.Option(
            "--search/--no-search",
            help="Rank all objects by their mean feature first, and classify only the best of them.",
        ),
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(
            metavar="WORDS",
            help="Keep only hits that are near an object of these words, separated by commas, in the same frame.",
        ),
    ] = None,
    within: Annotated[
        float | None,
        typer.Option(
            help="Largest horizontal gap between a hit and an object of --near (m); 5 without this option."
        ),
    ] = None,
    sheet: Annotated[
        bool, typer.Option("--sheet/--no-sheet", help="Draw the best hits into one picture.")
    ] = True,
    anyway: Anyway = False,
) -> None:
    """Find objects by words: print a table, write out/query/*.parquet with all hits, and draw the best."""
    from upvl_cli.query.classes import classes_from_file, classes_from_phrases
    from upvl_cli.query.filters import Filters
    from upvl_cli.query.run import Near, Request
    from upvl_cli.query.run import query as answer

    if by not in (None, "vote", "mean"):
        raise BadSetting(f"--by {by}: expected vote or mean")
    if classes and phrases:
        raise BadSetting(
            "both phrases and --classes are given; put the phrases into the file, or leave it out"
        )
    if within is not None and (near is None or not 0 <= within < math.inf):
        raise BadSetting(f"--within {within}: expected metres from 0 on, together with --near WORDS")
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
    given = {"threshold": threshold, "top": top, "by": by, "search": search}
    queried = classes_from_file(classes) if classes else classes_from_phrases(phrases or [])
    request = Request(
        classes=queried,
        name=" ".join([classes.stem] if classes else queried.words) + (f" near {near}" if near else ""),
        source=on,
        filters=filters,
        sheet=sheet,
        check_spelling=not anyway,
        values={name: value for name, value in given.items() if value is not None},
        near=Near(classes_from_phrases([near]), 5.0 if within is None else within)
        if near is not None
        else None,
    )
    _print(answer(context.obj, request))


@app.command()
def words(
    context: typer.Context,
    listed: Annotated[
        str | None,
        typer.Argument(metavar="WORDS", help='The words, separated by commas: "car, fire truck, tram".'),
    ] = None,
    suggest: Annotated[
        bool,
        typer.Option(
            "--suggest",
            help="List what is in the drives without being asked for: clusters of tracks, their nearest words, and "
            "those that fit no word. Writes out/query/suggest.parquet and suggest-tracks.parquet.",
        ),
    ] = False,
    clusters: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of clusters of --suggest. Without this option clusters are merged that differ by no more "
            "than the views of one object.",
        ),
    ] = None,
    on: On = None,
    segment: Segments = None,
    anyway: Anyway = False,
) -> None:
    """Count the boxes that each word wins, and the words that would win them without it; or suggest words."""
    from upvl_cli.query.classes import classes_from_phrases
    from upvl_cli.query.suggest import suggest_words
    from upvl_cli.query.words import compare_words

    if suggest and listed is not None:
        raise BadSetting("both WORDS and --suggest are given; --suggest asks for none: leave one out")
    if suggest:
        _print(suggest_words(context.obj, on, segment or (), clusters))
        return
    if clusters is not None:
        raise BadSetting("--clusters is given without --suggest; add --suggest, or leave it out")
    if listed is None:
        raise BadSetting('no word is given; name some: upvl words "car, truck", or ask: upvl words --suggest')
    classes = classes_from_phrases([listed])
    _print(compare_words(context.obj, classes, on, segment or (), check_spelling=not anyway))


def _print(items: Iterable[Any]) -> None:
    from rich.console import Console

    width = None if Console().is_terminal else WIDE
    for item in items:
        Console(soft_wrap=isinstance(item, str), width=width).print(item, markup=False, highlight=False)
