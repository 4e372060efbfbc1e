"""The command that writes the report of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.pipeline.workspace import Workspace


@app.command()
def report(
    context: typer.Context,
    segment: Segments = None,
    to: Annotated[
        Path | None,
        typer.Option(
            help="File of the page; report.html in the folder of the results when left out.", metavar="FILE"
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results of another run over the same drives, such as out2: the page tells what "
            "changed against it.",
            metavar="DIR",
        ),
    ] = None,
) -> None:
    """Write one HTML page about the labels, which opens without network: counts, maps, pictures, time, settings."""
    from rich.console import Console

    from upvl_cli.report.run import write_report

    workspace: Workspace = context.obj
    with Console(stderr=True).status(
        "gathering counts, maps and pictures"
    ):  # quiet where there is no terminal
        written = write_report(workspace, segment or (), to or workspace.out / "report.html", against)
    for note in written.notes:
        print(note)
    print(f"{written.path} ({written.size_bytes / 1e6:.1f} MB)")
