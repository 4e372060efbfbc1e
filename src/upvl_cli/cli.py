"""The `upvl` command: one sub-command a stage, built from its declaration, and the one error handler."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from upvl_cli.errors import BadSetting, UpvlError, one_line
from upvl_cli.stage import Param, Stage, params_of
from upvl_cli.stages import STAGES
from upvl_cli.workspace import Workspace

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Unsupervised 3D perception: from raw drives to auto labels, without a single 3D human label.",
)

Segments = Annotated[
    list[str] | None,
    typer.Option("--segment", "-s", help="Only this drive; can be given again.", metavar="NAME"),
]
MOVING_ONLY = "moving-only"  # the preset of those labels
OneSegment = Annotated[str | None, typer.Argument(help="The drive; all of them when left out.")]
OneFrame = Annotated[int | None, typer.Option(help="The frame; the middle one when left out.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that share the drives between them.")]


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
    except TyperException as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context else "upvl"
        message = getattr(error, "format_message", error.__str__)()
        if message.strip():  # without a sub-command the help says all there is to say
            print(f"upvl: {' '.join(message.split())} (see: {path} --help)", file=sys.stderr)
    return 2


@app.callback()
def workspace_options(
    context: typer.Context,
    stages: Annotated[Path, typer.Option(envvar="UPVL_STAGES", help="Folder of the settings.")] = Path(
        "stages"
    ),
    out: Annotated[Path, typer.Option(envvar="UPVL_OUT", help="Folder of the results.")] = Path("out"),
) -> None:
    """Take the folders of the workspace; commands run in it and need no path."""
    context.obj = Workspace(stages, out)


def _stage_command(stage: Stage) -> Callable[..., None]:
    """A command whose options are the settings of a stage."""

    def command(
        context: typer.Context, segment: list[str] | None = None, workers: int = 1, **values: Any
    ) -> None:
        overrides = {name: value for name, value in values.items() if value is not None}
        label(context.obj, [stage], segment, workers=workers, overrides=overrides)

    fixed: list[tuple[str, Any, Any]] = [("context", typer.Context, None)]
    if not stage.whole:
        fixed += [("segment", Segments, None), ("workers", Workers, 1)]
    options = [
        (name, (list[str] if kind == tuple[str, ...] else kind) | None, _option(spec))
        for name, (kind, spec) in params_of(stage.params).items()
    ]
    parameters = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            annotation=annotation,
            default=inspect.Parameter.empty if annotation is typer.Context else default,
        )
        for name, annotation, default in [*fixed, *options]
    ]
    command.__name__ = stage.name
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def _option(spec: Param) -> Any:
    # Round brackets: rich takes square ones for its own marks and swallows them.
    notes = ", ".join(part for part in (spec.unit, spec.bounds) if part)
    text = spec.meaning + (f" ({notes})" if notes else "")
    return typer.Option(None, help=text, show_default="as in the TOML file", rich_help_panel="Settings")


for _stage in STAGES:
    app.command(_stage.name, help=_stage.summary, rich_help_panel="Stages")(_stage_command(_stage))


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
    """Label the drives: all stages in order, then a summary."""
    if moving_only is None:
        raise BadSetting("say which objects to label: upvl autolabel --moving-only, or --all-motion")
    from upvl_cli.sweep import checked_preset, remember

    given: Workspace = context.obj
    preset = checked_preset(given.stages, MOVING_ONLY) if moving_only else ""
    context.obj = Workspace(given.stages, given.out, preset)
    remember(context.obj)
    label(context.obj, STAGES, segment, workers=workers, overrides={})
    summary(context)


def label(
    workspace: Workspace,
    stages: Sequence[Stage],
    segments: Sequence[str] | None,
    *,
    workers: int,
    overrides: Mapping[str, Any],
) -> None:
    """Run stages with a progress display on a terminal, and a line a shard elsewhere."""
    from upvl_cli.progress import Progress
    from upvl_cli.runner import run_all

    chosen = segments or list(workspace.segments)
    for name in chosen:
        workspace.check_name(name, workspace.segments)
    with Progress(sum(1 if stage.whole else len(chosen) for stage in stages)) as progress:
        for made in run_all(
            workspace, stages, chosen, overrides=overrides, workers=workers, tick=progress.tick
        ):
            progress.done(made)


@app.command()
def summary(context: typer.Context) -> None:
    """Tell what the auto labels hold and what was dropped, and why."""
    from upvl_cli.summary import lines

    for line in lines(context.obj):
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

    from upvl_cli.progress import status_table
    from upvl_cli.status import status as statuses

    Console().print(status_table(statuses(context.obj)))


@app.command()
def plan(context: typer.Context) -> None:
    """Write the rules and marks that make follows."""
    from upvl_cli.plan import plan as write_plan

    write_plan(context.obj)


@app.command()
def docs(
    context: typer.Context,
    page: Annotated[Path, typer.Argument(help="The page to write.")] = Path("docs/pipeline.md"),
) -> None:
    """Write the page that documents the stages."""
    from upvl_cli.plan import page as text
    from upvl_cli.workspace import write_if_changed

    write_if_changed(page, text(STAGES, context.obj.stages))


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="Folder of the new workspace.")]) -> None:
    """Make a new workspace for your own drives."""
    from upvl_cli.template import create

    create(folder)
    print(
        f"{folder} is ready: name your drives in {folder / 'stages' / 'raw.toml'}, then in {folder} run: make pipeline"
    )


@app.command()
def draw(
    context: typer.Context,
    segment: OneSegment = None,
    frame: OneFrame = None,
) -> None:
    """Draw points, boxes and tracks from above, and boxes on the camera's picture."""
    from upvl_cli.look import draw_frame

    workspace: Workspace = context.obj
    for name in workspace.segments if segment is None else [segment]:
        workspace.check_name(name, workspace.segments)
        for path in draw_frame(workspace, name, frame):
            print(path)


synth = typer.Typer(no_args_is_help=True, help="Look at the built-in drives, which are made up.")
app.add_typer(synth, name="synth")


@synth.command("preview")
def synth_preview(
    context: typer.Context,
    segment: OneSegment = None,
    frame: OneFrame = None,
) -> None:
    """Draw a contact sheet: the cameras, what each pixel is, and the sweep from above."""
    from upvl_cli.preview import preview

    workspace: Workspace = context.obj
    for name in workspace.segments if segment is None else [segment]:
        print(preview(workspace, name, frame))


@synth.command("kinds")
def synth_kinds() -> None:
    """List the kinds of object, with the words that people use for each."""
    from upvl_cli.datasets.city.kinds import KINDS

    for kind in KINDS.values():
        print(f"{kind.name}: {', '.join(kind.words)}")


@app.command("eval")
def evaluate(
    context: typer.Context,
    what: Annotated[str, typer.Option(help="labels, detections or tracks.")] = "labels",
    moving_only: Annotated[
        bool, typer.Option("--moving-only/--all-motion", help="Which labels to ask for.")
    ] = True,
    class_agnostic: Annotated[
        bool | None,
        typer.Option("--class-agnostic/--by-class", help="Any object is right, whatever its class."),
    ] = None,
    region: Annotated[
        str | None, typer.Option(metavar="LxW", help="Only this far around the car: 100x40 (m).")
    ] = None,
    iou: Annotated[
        list[float] | None, typer.Option(help="Least 3D IoU of a match; several: --iou 0.4 0.5.")
    ] = None,
    more: Annotated[list[float] | None, typer.Argument(hidden=True, metavar="IOU")] = None,
) -> None:
    """Score the auto labels against human labels: tables, out/eval/*.json and pictures."""
    from rich.console import Console

    from upvl_cli.evaluation import run

    overrides = {"iou": sorted({*(iou or ()), *(more or ())})} if iou or more else {}
    report = run.evaluate(context.obj, what, moving_only, class_agnostic, region, overrides)
    paths = list(run.write(context.obj, report))
    for item in [*run.shown(report), *map(str, paths)]:
        Console(soft_wrap=isinstance(item, str)).print(item, markup=False, highlight=False)


@app.command()
def tables(context: typer.Context) -> None:
    """Fill the paper's tables on the drives of this workspace, beside the published figures."""
    from rich.console import Console

    from upvl_cli.evaluation import paper_tables
    from upvl_cli.progress import Progress

    from upvl_cli.sweep import remember

    workspace = Workspace(context.obj.stages, context.obj.out, "")
    remember(workspace)
    shards = len(STAGES) * len(workspace.segments) * len(paper_tables.presets(workspace))
    with Progress(shards) as progress:
        filled = list(paper_tables.fill(workspace, progress))
    path = paper_tables.write(workspace, filled)
    for table, rows in filled:
        Console().print(paper_tables.shown(table, rows), "", highlight=False)
    print(path)
