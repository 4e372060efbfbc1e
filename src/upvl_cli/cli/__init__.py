"""The `upvl` command: one sub-command a stage, built from its declaration, and the one error handler."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from typer.exceptions import TyperException

# Each module adds its commands to the application when it is imported; in help they stand in this order.
from upvl_cli.cli import labels

# isort: split
from upvl_cli.cli import import_

# isort: split
from upvl_cli.cli import check

# isort: split
from upvl_cli.cli import stages

# isort: split
from upvl_cli.cli import query

# isort: split
from upvl_cli.cli import index

# isort: split
from upvl_cli.cli import draw

# isort: split
from upvl_cli.cli import view

# isort: split
from upvl_cli.cli import report

# isort: split
from upvl_cli.cli import serve

# isort: split
from upvl_cli.cli import export

# isort: split
from upvl_cli.cli import evaluate, train
from upvl_cli.cli.application import app
from upvl_cli.errors import UpvlError, one_line

COMMANDS = (labels, import_, check, stages, query, index, draw, view, report, serve, export, evaluate, train)


def run(arguments: Sequence[str]) -> int:
    """Run one command; returns the exit code: 0, 2 for what a user can mend, 130 when a person stops it.

    Args:
        arguments: The words after `upvl`; none at all asks for help.
    """
    try:
        # Not "standalone": typer would frame its messages over several lines.
        return app(list(arguments) or ["--help"], prog_name="upvl", standalone_mode=False) or 0
    except UpvlError as error:
        print(f"upvl: {one_line(error)}", file=sys.stderr)
    except MemoryError:
        print(
            f"upvl: {arguments[0]} ran out of memory; close other programs, or ask for fewer drives at once",
            file=sys.stderr,
        )
    except TyperException as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context else "upvl"
        message = getattr(error, "format_message", error.__str__)()
        if message.strip():  # without a sub-command the help says all there is to say
            print(f"upvl: {' '.join(message.split())} (see: {path} --help)", file=sys.stderr)
    return 2
