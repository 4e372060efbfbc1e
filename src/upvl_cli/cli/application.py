"""The application, and the options that commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.workspace import Workspace

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Unsupervised 3D perception: from raw drives to auto labels, without a single 3D human label.",
)

Segments = Annotated[
    list[str] | None,
    typer.Option("--segment", "-s", help="Only this drive; can be given again.", metavar="NAME"),
]
OneSegment = Annotated[str | None, typer.Argument(help="The drive; all of them when left out.")]
OneFrame = Annotated[int | None, typer.Option(help="The frame; the middle one when left out.")]
DryRun = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Estimate the size of the shards from a few frames, and make none; with --on slurm, print the script of "
        "the job array, and submit nothing.",
    ),
]
ScriptOnly = Annotated[
    bool, typer.Option("--dry-run", help="Print the script of --on slurm, and submit nothing.")
]
Workers = Annotated[
    int,
    typer.Option(
        min=1, help="Processes that share the drives between them: N is the same as --on processes:N."
    ),
]
On = Annotated[
    str | None,
    typer.Option(
        "--on",
        metavar="EXECUTOR",
        help="Where the shards are made. serial: in this process; processes:N: in N processes of this machine; ray, "
        "ray://HOST:PORT: on a Ray cluster; slurm: as jobs of a SLURM queue. Without it: in this process.",
    ),
]
Slurm = Annotated[
    str,
    typer.Option(
        "--slurm",
        metavar="NAME=VALUE,...",
        help="What each task of --on slurm asks for: partition, account and qos by name, time in minutes, memory in "
        "GiB, cpus, gpus, and tasks, the most of the array; such as partition=gpu,time=120.",
    ),
]
ShardOption = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="I/N",
        help="Only every N-th drive of the sorted list from the I-th on, counted from 1: the share of one of N "
        "processes that a batch system starts.",
    ),
]


def _print_version(asked: bool) -> None:
    """Print the version of the installed package and end; no workspace is read and nothing heavy is loaded."""
    if asked:
        from importlib.metadata import version

        typer.echo(f"upvl {version('upvl')}")
        raise typer.Exit


@app.callback()
def workspace_options(
    context: typer.Context,
    stages: Annotated[Path, typer.Option(envvar="UPVL_STAGES", help="Folder of the settings.")] = Path(
        "stages"
    ),
    out: Annotated[Path, typer.Option(envvar="UPVL_OUT", help="Folder of the results.")] = Path("out"),
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit."),
    ] = False,
) -> None:
    """Take the folders of the workspace; commands run in it and need no path."""
    context.obj = Workspace(PIPELINE, stages, out)
