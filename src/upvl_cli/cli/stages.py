"""One command a stage, whose options are the settings of the stage."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperCommand

from upvl_cli.cli.application import DryRun, On, ScriptOnly, Segments, ShardOption, Slurm, Workers, app
from upvl_cli.cli.run import RunOptions, run_stages, run_window
from upvl_cli.config.base import Setting, settings_of
from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import STAGES, pool_features

DETECTOR, LABELS = "detector", "labels"  # what `detect` gives the objects of
_PRESET = typer.Option(
    help="Folder of stages/presets whose values replace those of the TOML files from now on, such as small or "
    'paper; "" goes back to the TOML files.'
)
_ON = typer.Option(
    help=f"Whose objects to write. {DETECTOR}: run the trained detector. {LABELS}: copy the auto labels with the "
    "features of their points, which needs no training. Can be given a second time, to say where the shards are made: "
    "serial, processes:N, ray, ray://HOST:PORT or slurm."
)

_WINDOW = typer.Option(
    metavar="I/N",
    help="Make one of N windows of the frames of each drive, counted from 1. Whoever makes the last window of a drive "
    "joins them to its shard, which has the same bytes as one that was made at once.",
)


class StageCommand(TyperCommand):
    """A command whose help shows, for each setting, the value that a run would use now."""

    stage: AnyStage

    def format_help(self, context: Any, formatter: Any) -> None:
        """Write the help, with the values of the workspace where there is one."""
        with suppress(UpvlError):  # outside of a workspace there are no values to show
            workspace: Workspace = context.obj
            values = workspace.settings(self.stage)
            shown = {"_".join(spec.path): spec.value_in(values) for spec in settings_of(self.stage.config)}
            for parameter in self.params:
                if parameter.name in shown:
                    value = _as_toml(shown[parameter.name])
                    parameter.help += f"\n\nValue now: {value}"  # type: ignore[attr-defined]
        super().format_help(context, formatter)


def _as_toml(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_as_toml, value)) or "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _command_of(stage: AnyStage) -> Callable[..., None]:
    """Return a function whose signature has an option for each setting of a stage."""
    declared = list(settings_of(stage.config))

    def command(
        context: typer.Context,
        segment: list[str] | None = None,
        workers: int = 1,
        dry_run: bool = False,
        on: str | list[str] | None = None,
        shard: str | None = None,
        slurm: str = "",
        preset: str | None = None,
        window: str | None = None,
        **values: Any,
    ) -> None:
        overrides = nested({name: value for name, value in values.items() if value is not None}, declared)
        if preset is not None:
            from upvl_cli.pipeline.presets import with_preset

            context.obj = with_preset(context.obj, preset, [stage])
        made, where = _objects_and_place(on, stage, overrides) if isinstance(on, list) else (stage, on)
        if made is not stage:
            overrides = {}
        options = RunOptions(segment, workers, where, shard, slurm, dry_run)
        if window is not None:
            run_window(context.obj, stage, options, window, overrides)
            return
        if dry_run and not options.prints_script:
            if not stage.estimates_size:
                raise BadSetting("--dry-run prints the script of a queue: give it with --on slurm")
            print_sizes(context.obj, stage, options.chosen(context.obj), overrides)
        else:
            run_stages(context.obj, [made], options, overrides)

    fixed = _fixed_options(stage)
    options = [("_".join(spec.path), _option_type(spec) | None, _option(spec)) for spec in declared]
    command.__name__ = stage.name
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
            for name, annotation, default in [*fixed, *options]
        ]
    )
    return command


def _fixed_options(stage: AnyStage) -> list[tuple[str, Any, Any]]:
    """Return the options of a stage that are no settings: name, type and default."""
    fixed: list[tuple[str, Any, Any]] = [("context", typer.Context, inspect.Parameter.empty)]
    if not stage.is_of_dataset:
        fixed += [("segment", Segments, None), ("workers", Workers, 1), ("shard", ShardOption, None)]
    fixed += [("dry_run", DryRun if stage.estimates_size else ScriptOnly, False), ("slurm", Slurm, "")]
    if stage.windowed:
        fixed.append(("window", Annotated[str | None, _WINDOW], None))
    if stage.name == "train":
        fixed.append(("preset", Annotated[str | None, _PRESET], None))
    if stage.name == "detect":
        fixed.append(("on", Annotated[list[str] | None, _ON], None))
    else:
        fixed.append(("on", On, None))
    return fixed


def _objects_and_place(
    on: Sequence[str], detect: AnyStage, overrides: Mapping[str, object]
) -> tuple[AnyStage, str | None]:
    """Return the stage that writes the objects that `detect --on` asks for, and where its shards are made."""
    from upvl_cli.pipeline.executors.choose import FORMS, is_executor

    places = [value for value in on if is_executor(value)]
    objects = [value for value in on if not is_executor(value)]
    if len(places) > 1 or len(objects) > 1:
        raise BadSetting(f"--on {' --on '.join(on)}: expected whose objects once, and where to work once")
    for value in objects:
        if value not in (DETECTOR, LABELS):
            raise BadSetting(f"--on {value!r}: expected {DETECTOR} or {LABELS}, or where to work: {FORMS}")
    if overrides and objects == [LABELS]:
        raise BadSetting(f"--on {LABELS} takes no settings: it copies the auto labels as they are")
    return pool_features.STAGE if objects == [LABELS] else detect, places[0] if places else None


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
    """Return the type that typer parses; ranges and choices are checked with those of the TOML file."""
    if get_origin(spec.type) is tuple:
        return list[get_args(spec.type)[0]]  # type: ignore[misc]
    return str if spec.choices else spec.type


def _option(spec: Setting) -> Any:
    # Round brackets: rich takes square ones for its own marks and swallows them.
    notes = ", ".join(part for part in (spec.unit, "" if spec.effects else spec.bounds) if part)
    effects = "".join(f"\n\n- {choice}: {effect}" for choice, effect in spec.effects.items())
    text = spec.meaning + (f" ({notes})" if notes else "") + effects
    panel = "Settings" if len(spec.path) == 1 else f"Settings of the table {'.'.join(spec.path[:-1])}"
    return typer.Option(None, help=text, show_default=False, rich_help_panel=panel)


def print_sizes(
    workspace: Workspace, stage: AnyStage, segments: Sequence[str] | None, overrides: Mapping[str, object]
) -> None:
    """Print how large the shards of a stage will be."""
    from upvl_cli.commands.estimate_size import estimate_size

    settings = workspace.with_values(stage, overrides)
    total = 0
    for name in segments or workspace.segments:
        workspace.check_name(name, workspace.segments)
        size, per_frame = estimate_size(workspace, stage, name, settings)
        total += size
        print(f"{name}: {size / 1e6:.1f} MB ({per_frame / 1e6:.2f} MB a frame)")
    print(f"{stage.name}: {total / 1e6:.1f} MB in all; nothing was made")


for _stage in STAGES:
    _class = type(f"{_stage.name}-command", (StageCommand,), {"stage": _stage})
    app.command(_stage.name, help=_stage.summary, rich_help_panel="Stages", cls=_class)(_command_of(_stage))
