"""The commands that score labels, detections and tracks against human labels."""

from __future__ import annotations

from typing import Annotated

import typer

from upvl_cli.cli.application import Segments, app
from upvl_cli.cli.check import warn_of_labels
from upvl_cli.pipeline.workspace import Workspace


@app.command("eval")
def evaluate(
    context: typer.Context,
    what: Annotated[
        str,
        typer.Option(
            metavar="labels|detections|tracks",
            help="Boxes to score. labels: the auto labels, and their flow where the true flow is known; "
            "detections: the boxes of the stage detect; tracks: the identities of the auto labels.",
        ),
    ] = "labels",
    moving_only: Annotated[
        bool | None,
        typer.Option(
            "--moving-only/--all-motion",
            help="Count only labels at least as fast as moving_mps, or labels of all motion states; "
            "without either, those that the auto labels of this folder were made for.",
            show_default=False,
        ),
    ] = None,
    class_agnostic: Annotated[
        bool,
        typer.Option(
            "--class-agnostic/--by-class",
            help="Score all objects as one class, or add the average precision of vehicles and of vulnerable road "
            "users (VRU: pedestrians and cyclists).",
        ),
    ] = True,
    segment: Segments = None,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="LxW",
            help="Count only labels and boxes whose centre lies in a rectangle around the car, length x width in "
            "metres, such as 100x40; without it, all.",
        ),
    ] = None,
    iou: Annotated[
        list[float] | None,
        typer.Option(
            help="3D IoU with a label from which a box is right, 0.001 to 1; several as --iou 0.4 0.5. "
            "Without it, iou of eval.toml."
        ),
    ] = None,
    truth: Annotated[
        str,
        typer.Option(
            metavar="labels|corrections",
            help="What boxes are scored against. labels: the human labels of the dataset; corrections: the auto labels "
            "as a person has corrected them (upvl import-labels), in the drives that have corrections.",
        ),
    ] = "labels",
    more: Annotated[list[float] | None, typer.Argument(hidden=True, metavar="IOU")] = None,
) -> None:
    """Score auto labels, detections or tracks against human labels: tables, out/eval/*.json and plots."""
    from rich.console import Console

    from upvl_cli.evaluation import run

    overrides = {"iou": sorted({*(iou or ()), *(more or ())})} if iou or more else {}
    report = run.evaluate(
        context.obj, what, moving_only, class_agnostic, region, overrides, segment or (), truth
    )
    if truth == "labels":
        warn_of_labels(context.obj, segment)
    paths = list(run.write(context.obj, report))
    for item in [*run.render(report), *map(str, paths)]:
        Console(soft_wrap=isinstance(item, str)).print(item, markup=False, highlight=False)


@app.command()
def tables(
    context: typer.Context,
    detectors: Annotated[
        bool,
        typer.Option(
            "--detectors",
            help="Train a detector for each row that scores one; all rows are then scored in the drives that "
            "train.toml leaves out. Without it these rows stay empty.",
        ),
    ] = False,
) -> None:
    """Fill the tables of the UP-VL paper on the drives of this workspace, beside the published figures."""
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
        Console().print(paper_tables.render(table, rows), "", highlight=False)
    print(path)
