"""The command that shows a workspace as a web page."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from upvl_cli.cli.application import app


@app.command()
def serve(
    context: typer.Context,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port that the server listens on; 0 takes a free one.")
    ] = 8700,
    host: Annotated[
        str,
        typer.Option(
            help="Address that the server listens on. Any but the own machine's (127.0.0.1) can be reached by others "
            "and needs a token."
        ),
    ] = "127.0.0.1",
    token: Annotated[
        str,
        typer.Option(
            envvar="UPVL_TOKEN",
            help="Secret of at least 16 letters that the first address opened in a browser has to hold. Made and "
            "printed where --host needs one and none is given.",
        ),
    ] = "",
    access_log: Annotated[
        bool, typer.Option("--access-log", help="Write a line to the terminal for each request.")
    ] = False,
) -> None:
    """Show the workspace as a web page: search by words, look at hits in 3D and in pictures, save them."""
    from upvl_cli.web.server import ServeOptions, serve

    def ready(address: str) -> None:
        print(f"{context.obj.out} is shown at {address} (Ctrl-C ends)", flush=True)

    if sys.stderr.isatty():
        print(f"opening {context.obj.out}; the first time a search index is made", file=sys.stderr)
    try:
        serve(context.obj, ServeOptions(host, port, token, access_log), ready)
    except KeyboardInterrupt:
        print("ended", flush=True)
