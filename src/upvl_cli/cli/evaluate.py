"""Commands that compare labels with the truth."""

from __future__ import annotations

from typing import Annotated

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.pipeline.workspace import Workspace


@app.command("eval")
def evaluate(
    context: typer.Context,
    what: Annotated[str, typer.Option(help="labels, detections or tracks.")] = "labels",
    moving_only: Annotated[
        bool, typer.Option("--moving-only/--all-motion", help="Which labels to ask for.")
    ] = True,
    class_agnostic: Annotated[
        bool,
        typer.Option(
            "--class-agnostic/--by-class", help="Any object is right, or the right name is asked for too."
        ),
    ] = True,
    segment: Segments = None,
    region: Annotated[
        str | None, typer.Option(metavar="LxW", help="Only this far around the car: 100x40 (m).")
    ] = None,
    iou: Annotated[
        list[float] | None, typer.Option(help="Least 3D IoU of a match; several: --iou 0.4 0.5.")
    ] = None,
    more: Annotated[list[float] | None, typer.Argument(hidden=True, metavar="IOU")] = None,
) -> None:
    """Score auto labels, detections or tracks against human labels: tables, out/eval/*.json and pictures."""
    from rich.console import Console

    from upvl_cli.evaluation import run

    overrides = {"iou": sorted({*(iou or ()), *(more or ())})} if iou or more else {}
    report = run.evaluate(context.obj, what, moving_only, class_agnostic, region, overrides, segment or ())
    paths = list(run.write(context.obj, report))
    for item in [*run.shown(report), *map(str, paths)]:
        Console(soft_wrap=isinstance(item, str)).print(item, markup=False, highlight=False)


@app.command()
def tables(
    context: typer.Context,
    detectors: Annotated[
        bool,
        typer.Option(
            "--detectors",
            help="Train detectors for their rows; all rows are then of the drives that train.toml leaves out.",
        ),
    ] = False,
) -> None:
    """Fill the paper's tables on the drives of this workspace, beside the published figures."""
    from rich.console import Console

    from upvl_cli.cli.progress import Progress
    from upvl_cli.evaluation import paper_tables
    from upvl_cli.pipeline.presets import note_preset

    workspace = Workspace(context.obj.pipeline, context.obj.stages, context.obj.out, "")
    note_preset(workspace)
    with Progress(paper_tables.shards(workspace, detectors=detectors)) as progress:
        filled = list(paper_tables.fill(workspace, progress, detectors=detectors))
    path = paper_tables.write(workspace, filled)
    for table, rows in filled:
        Console().print(paper_tables.shown(table, rows), "", highlight=False)
    print(path)
