"""Commands that make labels, and what describes a workspace."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from upvl_cli.cli.application import Segments, Workers, app
from upvl_cli.cli.run import run_stages
from upvl_cli.errors import BadSetting
from upvl_cli.stages import STAGES

MOVING_ONLY = "moving-only"  # the preset of those labels


@app.command()
def autolabel(
    context: typer.Context,
    moving_only: Annotated[
        bool | None,
        typer.Option("--moving-only/--all-motion", help="Label what moves, or parked objects as well."),
    ] = None,
    segment: Segments = None,
    workers: Workers = 1,
) -> None:
    """Label the drives: all stages that make labels in order, then a summary."""
    if moving_only is None:
        raise BadSetting("say which objects to label: upvl autolabel --moving-only, or --all-motion")
    from upvl_cli.pipeline.presets import with_preset

    context.obj = with_preset(
        context.obj, MOVING_ONLY if moving_only else "", context.obj.pipeline.labelling_stages
    )
    run_stages(context.obj, context.obj.pipeline.labelling_stages, segment, workers=workers, overrides={})
    summary(context, segment)


@app.command()
def summary(context: typer.Context, segment: Segments = None) -> None:
    """Tell what the auto labels hold and what was dropped, and why."""
    from upvl_cli.commands.summary import lines

    for name in segment or ():
        context.obj.check_name(name, context.obj.segments)
    for line in lines(context.obj, segment or ()):
        print(line)


@app.command()
def segments(context: typer.Context) -> None:
    """List the drives of the workspace."""
    for name in context.obj.segments:
        print(name)


@app.command()
def status(context: typer.Context) -> None:
    """Tell which shards are fresh, stale or missing."""
    from rich.console import Console

    from upvl_cli.cli.progress import status_table
    from upvl_cli.commands.status import status as statuses

    Console().print(status_table(statuses(context.obj)))


@app.command()
def plan(context: typer.Context) -> None:
    """Write the rules and marks that make follows."""
    from upvl_cli.pipeline.make_rules import write_rules

    write_rules(context.obj)


@app.command()
def docs(
    context: typer.Context,
    page: Annotated[Path, typer.Argument(help="The page to write.")] = Path("docs/pipeline.md"),
) -> None:
    """Write the page that documents the stages."""
    from upvl_cli.evaluation.config import EvalConfig
    from upvl_cli.pipeline.docs_page import Section
    from upvl_cli.pipeline.docs_page import page as page_of
    from upvl_cli.pipeline.workspace import RawConfig, VlmConfig
    from upvl_cli.query.config import QueryConfig
    from upvl_cli.runtime.atomic import write_if_changed
    from upvl_cli.synthetic.config import CityConfig

    before = (
        Section("raw", "Names the drives.", RawConfig),
        Section("vlm", "Names the vision-language model.", VlmConfig),
        Section("synthetic", "Makes the built-in drives, where `raw` names them.", CityConfig),
    )
    after = (
        Section("query", "Finds objects by words, in drives that need no picture.", QueryConfig),
        Section("eval", "Scores labels, tracks and flow where the truth is known.", EvalConfig),
    )
    write_if_changed(page, page_of(before, STAGES, after, context.obj.stages))


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="Folder of the new workspace.")]) -> None:
    """Make a new workspace for your own drives."""
    from upvl_cli.commands.init import create

    create(folder)
    print(
        f"{folder} is ready: name your drives in {folder / 'stages' / 'raw.toml'}, then in {folder} run: make pipeline"
    )
