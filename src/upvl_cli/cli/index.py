"""The command that makes the files of vectors of a search."""

from __future__ import annotations

import typer

from upvl_cli.cli.application import app
from upvl_cli.cli.query import On


@app.command()
def index(context: typer.Context, on: On = None) -> None:
    """Make the index of a search among millions of boxes: out/query/index/*.faiss, a file a group of drives."""
    from upvl_cli.query.vector_build import make_index

    for line in make_index(context.obj, on):
        typer.echo(line)
