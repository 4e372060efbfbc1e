"""The commands by which labels leave in the formats of other tools, and corrected ones come back."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.cli.filter_options import FromS, MaxRange, MaxSpeed, MinScore, MinSpeed, Moving, ToS
from upvl_cli.export.formats import FORMATS, export_format

if TYPE_CHECKING:
    from upvl_cli.export.drive import ExportDrive

_LIST = "; ".join(f"{name}: {entry.title}" for name, entry in FORMATS.items())
FormatName = Annotated[str, typer.Argument(metavar="FORMAT", help=f"The format. {_LIST}.")]


@app.command()
def export(
    context: typer.Context,
    format_name: FormatName,
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="New folder to write; an earlier export in it is replaced.")
    ],
    on: Annotated[
        str,
        typer.Option(
            help="Which boxes are exported. labels: the auto labels; corrected: the same with hand corrections over "
            "them where there are any; detections: the boxes of the trained detector, which have no class.",
            metavar="labels|corrected|detections",
        ),
    ] = "corrected",
    names: Annotated[
        str,
        typer.Option(
            help="What names a box. class: vehicle, pedestrian, cyclist, other or unknown; word: its word, such as "
            "bus, and the class where it has none.",
            metavar="class|word",
        ),
    ] = "class",
    only: Annotated[
        list[str] | None,
        typer.Option("--class", help="Export boxes of this class alone; can be given again.", metavar="NAME"),
    ] = None,
    query: Annotated[
        str | None,
        typer.Option(
            metavar="WORDS",
            help="Export the hits of a query for these words, separated by commas, each named by the word that was "
            "asked for; classes and --on corrected do not count then.",
        ),
    ] = None,
    moving: Moving = None,
    min_speed: MinSpeed = None,
    max_speed: MaxSpeed = None,
    max_range: MaxRange = None,
    segment: Segments = None,
    from_s: FromS = None,
    to_s: ToS = None,
    min_score: MinScore = None,
    camera: Annotated[
        str,
        typer.Option(
            help="Camera whose axes and picture a format with a single camera takes; without this option the one that "
            "looks most nearly forward."
        ),
    ] = "",
    world: Annotated[
        bool,
        typer.Option(
            "--world", help="Write points in the axes of the world; without this option in those of the car."
        ),
    ] = False,
    with_data: Annotated[
        bool,
        typer.Option(
            "--with-data",
            help="Write points and pictures too, where the format has a place for them, so that a tool can open "
            "the folder.",
        ),
    ] = False,
) -> None:
    """Write labels or detections in the format of another tool, and say what that format cannot carry."""
    from upvl_cli.export.format import ExportOptions
    from upvl_cli.export.workspace_export import BoxChoice, export_query, export_workspace
    from upvl_cli.query.filters import Filters

    fmt = export_format(format_name)
    filters = Filters(segment or (), moving, min_speed, max_speed, max_range, from_s, to_s, min_score)
    options = ExportOptions(camera, with_data, names=names, world_axes=world)
    if query is not None:
        source = None if on == "corrected" else on
        found = export_query(context.obj, fmt, folder, (query, source, filters), options, _with_progress)
    else:
        choice = BoxChoice(on, names, tuple(only or ()), filters)
        found = export_workspace(context.obj, fmt, folder, choice, options, _with_progress)
    for line in found.lines(folder):
        print(line)


@app.command("import-labels")
def import_labels(
    context: typer.Context,
    format_name: FormatName,
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of an export that a person has corrected.")
    ],
    segment: Segments = None,
) -> None:
    """Bring corrected labels back: what a person changed is kept in out/corrections, over the labels."""
    from upvl_cli.export.import_labels import import_labels as imported

    for drive in imported(context.obj, export_format(format_name), folder, segment or ()):
        counts = drive.counts
        changes = ", ".join(
            f"{counts[change]} {change}" for change in ("kept", "moved", "renamed", "new", "deleted")
        )
        print(f"{drive.segment}: {changes}; {drive.path}")
        if drive.note:
            print(f"  {drive.note}")


def _with_progress(drives: Iterable[ExportDrive], total: int) -> Iterator[ExportDrive]:
    """Yield the drives, and show on a terminal how many are written."""
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeRemainingColumn(),
    )
    live = sys.stderr.isatty()
    with bars.Progress(*columns, console=Console(stderr=True), transient=True, disable=not live) as shown:
        task = shown.add_task("drives", total=total)
        for drive in drives:
            shown.update(task, description=drive.name)
            yield drive
            shown.advance(task)
