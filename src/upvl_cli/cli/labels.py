"""Commands that make labels, one a stage and one for all, and what tells of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer

from upvl_cli.cli.application import DryRun, Segments, Workers, app
from upvl_cli.config.base import Setting, settings_of
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import STAGES, pool_features

MOVING_ONLY = "moving-only"  # the preset of those labels
MODEL, LABELS = "model", "labels"  # what `detect` looks with
_PRESET = typer.Option(
    help='Take the values of this folder of presets from now on, such as small or paper; "" for those that ship.'
)
_ON = typer.Option(
    help=f"{MODEL}: run the detector; {LABELS}: the same columns of the auto labels, without any training."
)


def _stage_command(stage: AnyStage) -> Callable[..., None]:
    """A command whose options are the settings of a stage."""

    def command(
        context: typer.Context,
        segment: list[str] | None = None,
        workers: int = 1,
        dry_run: bool = False,
        on: str = MODEL,
        preset: str | None = None,
        **values: Any,
    ) -> None:
        overrides = nested({name: value for name, value in values.items() if value is not None}, declared)
        if preset is not None:
            from upvl_cli.pipeline.presets import with_preset

            context.obj = with_preset(context.obj, preset, [stage])
        if on != MODEL:
            label(context.obj, [_instead(on, overrides)], segment, workers=workers, overrides={})
            return
        if dry_run:
            foretell(context.obj, stage, segment, overrides)
            return
        label(context.obj, [stage], segment, workers=workers, overrides=overrides)

    declared = list(settings_of(stage.config))
    fixed: list[tuple[str, Any, Any]] = [("context", typer.Context, None)]
    if not stage.is_of_dataset:
        fixed += [("segment", Segments, None), ("workers", Workers, 1)]
    if stage.estimates_size:
        fixed.append(("dry_run", DryRun, False))
    if stage.name == "train":
        fixed.append(("preset", Annotated[str | None, _PRESET], None))
    if stage.name == "detect":
        fixed.append(("on", Annotated[str, _ON], MODEL))
    options = [("_".join(spec.path), _option_type(spec) | None, _option(spec)) for spec in declared]
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


def _instead(on: str, overrides: Mapping[str, Any]) -> AnyStage:
    """The stage that gives what `detect` gives, of the auto labels, before any training."""
    if on != LABELS:
        raise BadSetting(f"--on {on!r}: expected {MODEL} or {LABELS}")
    if overrides:
        raise BadSetting(f"--on {LABELS} takes no settings: it gives the auto labels as they are")
    return pool_features.STAGE


def nested(values: Mapping[str, object], declared: Sequence[Setting]) -> dict[str, object]:
    """Return values of options as the tables of a TOML file: `rigid_eps_m` becomes `eps_m` of the table `rigid`."""
    tables: dict[str, Any] = {}
    for spec in declared:
        option = "_".join(spec.path)
        if option in values:
            inner = tables
            for name in spec.path[:-1]:
                inner = inner.setdefault(name, {})
            inner[spec.path[-1]] = values[option]
    return tables


def _option_type(spec: Setting) -> Any:
    """What typer is to make of an option: the settings check its range and choices themselves."""
    if get_origin(spec.type) is tuple:
        return list[get_args(spec.type)[0]]  # type: ignore[misc]
    return str if spec.choices else spec.type


def _option(spec: Setting) -> Any:
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
    """Label the drives: all stages that make labels in order, then a summary."""
    if moving_only is None:
        raise BadSetting("say which objects to label: upvl autolabel --moving-only, or --all-motion")
    from upvl_cli.pipeline.presets import with_preset

    context.obj = with_preset(
        context.obj, MOVING_ONLY if moving_only else "", context.obj.pipeline.labelling_stages
    )
    label(context.obj, context.obj.pipeline.labelling_stages, segment, workers=workers, overrides={})
    summary(context, segment)


def label(
    workspace: Workspace,
    stages: Sequence[AnyStage],
    segments: Sequence[str] | None,
    *,
    workers: int,
    overrides: Mapping[str, Any],
) -> None:
    """Run stages with a progress display on a terminal, and a line a shard elsewhere."""
    from upvl_cli.cli.progress import Progress
    from upvl_cli.pipeline.runner import run_all

    chosen = segments or list(workspace.segments)
    for name in chosen:
        workspace.check_name(name, workspace.segments)
    with Progress(sum(1 if stage.is_of_dataset else len(chosen) for stage in stages)) as progress:
        for made in run_all(
            workspace, stages, chosen, overrides=overrides, workers=workers, tick=progress.tick
        ):
            progress.done(made)


def foretell(
    workspace: Workspace, stage: AnyStage, segments: Sequence[str] | None, overrides: Mapping[str, Any]
) -> None:
    """Say how large the shards of a stage will be."""
    from upvl_cli.commands.estimate_size import forecast

    settings = workspace.with_values(stage, overrides)
    total = 0
    for name in segments or workspace.segments:
        workspace.check_name(name, workspace.segments)
        size, each = forecast(workspace, stage, name, settings)
        total += size
        print(f"{name}: {size / 1e6:.1f} MB ({each / 1e6:.2f} MB a frame)")
    print(f"{stage.name}: {total / 1e6:.1f} MB in all; nothing was made")


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
    from upvl_cli.commands.check_config import CheckConfig
    from upvl_cli.commands.fit_background_threshold import ThresholdFitConfig
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
        Section("check", "Checks times, pictures and calibration of a drive before it is labelled.", CheckConfig),
        Section(
            "fit-background-threshold",
            "Fits the background threshold of a model to unlabelled drives.",
            ThresholdFitConfig,
        ),
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
