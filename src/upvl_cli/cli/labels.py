"""Commands that make labels, and what describes a workspace."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from upvl_cli.cli.application import On, ScriptOnly, Segments, ShardOption, Slurm, Workers, app
from upvl_cli.cli.check import Anyway
from upvl_cli.cli.cost_options import (
    CpuPrice,
    Drives,
    Estimate,
    EstimateWorkers,
    GpuPrice,
    SampleSize,
    StoragePrice,
)
from upvl_cli.cli.run import RunOptions, print_script, run_stages
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import STAGES

MOVING_ONLY = "moving-only"  # the preset of those labels
WITHOUT_WORDS = "without-words"  # the preset of labels by LiDAR alone

FromCatalog = Annotated[
    bool,
    typer.Option(
        "--from-catalog",
        help="List no folder: the catalogue is taken for true, and shards that were made or deleted since it was "
        "written are not seen. Making a shard looks at the shard itself.",
    ),
]


@app.command()
def autolabel(
    context: typer.Context,
    moving_only: Annotated[
        bool | None,
        typer.Option("--moving-only/--all-motion", help="Label what moves, or parked objects as well."),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            "--pictures/--no-pictures",
            help="Tell parked objects from the background by words too, or by LiDAR alone; what moves needs no words.",
        ),
    ] = True,
    segment: Segments = None,
    workers: Workers = 1,
    on: On = None,
    shard: ShardOption = None,
    slurm: Slurm = "",
    dry_run: ScriptOnly = False,
    anyway: Anyway = False,
) -> None:
    """Check each drive quickly, then label it: all stages that make labels in order, then a summary."""
    if moving_only is None:
        raise BadSetting("say which objects to label: upvl autolabel --moving-only, or --all-motion")
    from upvl_cli.pipeline.presets import with_preset

    preset = MOVING_ONLY if moving_only else "" if pictures else WITHOUT_WORDS
    context.obj = with_preset(context.obj, preset, context.obj.pipeline.labelling_stages)
    options = RunOptions(segment, workers, on, shard, slurm, dry_run)
    if options.prints_script:
        print_script(context.obj, context.obj.pipeline.labelling_stages, options)
        return
    if dry_run:
        raise BadSetting("--dry-run prints the script of a queue: give it with --on slurm")
    from upvl_cli.commands.first_check import first_check

    check = first_check(context.obj, anyway=anyway)
    run_stages(context.obj, context.obj.pipeline.labelling_stages, options, {}, check)
    if chosen := options.chosen(context.obj):
        summary(context, segment if shard is None else chosen)


@app.command()
def summary(context: typer.Context, segment: Segments = None) -> None:
    """Tell what the auto labels hold, what was dropped and why, and what of it is suspicious."""
    from upvl_cli.commands.summary import lines
    from upvl_cli.commands.verdict import verdict

    for name in segment or ():
        context.obj.check_name(name, context.obj.segments)
    workspace: Workspace = context.obj
    for line in lines(workspace, segment or ()):
        print(line)
    labelled = [name for name in segment or workspace.segments if workspace.shard("labels", name).exists()]
    for line in verdict(workspace, labelled) if labelled else ():
        print(line)


@app.command()
def segments(context: typer.Context) -> None:
    """List the drives of the workspace."""
    for name in context.obj.segments:
        print(name)


@app.command()
def status(
    context: typer.Context,
    cost: Annotated[
        bool,
        typer.Option(
            "--cost", help="Print what the shards took, beside the figures of upvl plan --estimate."
        ),
    ] = False,
    from_catalog: FromCatalog = False,
) -> None:
    """Tell which shards are fresh, stale or missing; or, with --cost, what they took."""
    if cost:
        from upvl_cli.cli.costs import print_true_costs

        print_true_costs(context.obj)
        return
    from rich.console import Console

    from upvl_cli.cli.progress import Counter, status_table
    from upvl_cli.commands.status import status as statuses
    from upvl_cli.pipeline.catalog.catalog import Reading

    with Counter("reading footers of shards") as footers:
        found = statuses(context.obj, Reading(tick=footers.tick, lists=not from_catalog))
    Console().print(status_table(found))


@app.command()
def plan(
    context: typer.Context,
    next_: Annotated[
        int | None,
        typer.Option(
            "--next",
            metavar="COUNT",
            min=1,
            help="Print at most that many shards that can be made now, a line each: stage, tab, drive. Their inputs "
            "are fresh, so that they can be made in any order; no rules are written.",
        ),
    ] = None,
    estimate: Estimate = False,
    drives: Drives = None,
    sample: SampleSize = 2,
    workers: EstimateWorkers = 1,
    price_cpu_hour: CpuPrice = None,
    price_gpu_hour: GpuPrice = None,
    price_tb_month: StoragePrice = None,
    from_catalog: FromCatalog = False,
) -> None:
    """Write the rules and marks that make follows; or print the next shards to make, or what labelling takes."""
    if estimate:
        from upvl_cli.cli.costs import print_estimate
        from upvl_cli.commands.cost_estimate import Prices

        prices = Prices(price_cpu_hour, price_gpu_hour, price_tb_month)
        print_estimate(context.obj, drives=drives, sample=sample, workers=workers, prices=prices)
        return
    of_estimate = (drives, sample, workers, price_cpu_hour, price_gpu_hour, price_tb_month)
    if of_estimate != (None, 2, 1, None, None, None):
        raise BadSetting("the options of plan need --estimate: upvl plan --estimate")
    if next_ is None and from_catalog:
        raise BadSetting("--from-catalog is for the tasks of --next: upvl plan --next 1000 --from-catalog")
    if next_ is None:
        from upvl_cli.pipeline.make_rules import write_rules

        write_rules(context.obj)
        return
    from upvl_cli.cli.progress import Counter
    from upvl_cli.pipeline.catalog.catalog import Reading
    from upvl_cli.pipeline.catalog.tasks import next_tasks

    workspace: Workspace = context.obj
    with Counter("reading footers of shards") as footers:
        tasks = next_tasks(
            workspace, workspace.pipeline.stages, next_, Reading(tick=footers.tick, lists=not from_catalog)
        )
    for stage, segment in tasks:
        print(f"{stage}\t{segment}")


@app.command()
def docs(
    context: typer.Context,
    page: Annotated[
        Path, typer.Argument(help="The page of the stages; tables.md is written beside it.")
    ] = Path("docs/pipeline.md"),
) -> None:
    """Write the pages that document the stages and the tables."""
    from upvl_cli.commands.check_config import CheckConfig
    from upvl_cli.commands.fit_background_threshold import ThresholdFitConfig
    from upvl_cli.evaluation.config import EvalConfig
    from upvl_cli.pipeline.docs_page import Section
    from upvl_cli.pipeline.docs_page import page as page_of
    from upvl_cli.pipeline.tables_page import tables_page
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
        Section(
            "check", "Checks times, pictures and calibration of a drive before it is labelled.", CheckConfig
        ),
        Section(
            "fit-background-threshold",
            "Fits the background threshold of a model to unlabelled drives.",
            ThresholdFitConfig,
        ),
    )
    write_if_changed(page, page_of(before, STAGES, after, context.obj.stages))
    write_if_changed(page.with_name("tables.md"), tables_page(STAGES))


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="Folder of the new workspace.")]) -> None:
    """Make a new workspace for your own drives."""
    from upvl_cli.commands.init import create

    create(folder)
    print(
        f"{folder} is ready: name your drives in {folder / 'stages' / 'raw.toml'}, then in {folder} run: make pipeline"
    )
