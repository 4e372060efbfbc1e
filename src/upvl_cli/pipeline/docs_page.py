"""The page that documents the stages, from their declarations and their values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.config.base import Config, settings_of
from upvl_cli.config.toml import load
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.stage import columns_of


@dataclass(frozen=True)
class Section:
    """Settings that belong to no stage: the name of their TOML file, what they are for, and their declaration."""

    name: str
    summary: str
    config: type[Config]


def page(
    before: Sequence[Section], stages: Sequence[AnyStage], after: Sequence[Section], folder: Path
) -> str:
    """Return the page, as Markdown.

    Args:
        before: Sections above the stages.
        stages: The stages, in order.
        after: Sections below the stages.
        folder: Folder of the TOML files whose values are shown.
    """
    lines = [
        "# The pipeline",
        "",
        "Made by `make docs` from the declarations in `src/upvl_cli/stages/`; a test compares the two.",
        "",
    ]
    for section in before:
        lines += [
            f"## {section.name}",
            "",
            section.summary,
            "",
            *_settings(section.name, section.config, folder),
        ]
    for stage in stages:
        lines += [f"## {stage.name}", "", stage.summary, ""]
        lines += [f"Reads {', '.join(f'`{source}`' for source in stage.reads)}.", ""]
        lines += [*_settings(stage.name, stage.config, folder), *_columns(stage), ""]
    for section in after:
        lines += [
            f"## {section.name}",
            "",
            section.summary,
            "",
            *_settings(section.name, section.config, folder),
        ]
    return "\n".join(lines)


def _settings(name: str, config: type[Config], folder: Path) -> Iterator[str]:
    values, declared = load(config, folder / f"{name}.toml"), list(settings_of(config))
    if not declared:
        return
    yield from ("| setting | value | range | meaning |", "| --- | --- | --- | --- |")
    for spec in declared:
        value = f"`{spec.value_in(values)!r}`{' ' + spec.unit if spec.unit else ''}"
        effects = "".join(f"<br>`{choice}`: {effect}" for choice, effect in spec.effects.items())
        bounds = "" if spec.effects else spec.bounds
        yield f"| `{spec.name}` | {value} | {bounds} | {spec.meaning}{effects} |"
    yield ""


def _columns(stage: AnyStage) -> Iterable[str]:
    yield from ("| column | type | one for each | meaning |", "| --- | --- | --- | --- |")
    for name, spec in columns_of(stage.row).items():
        shape = f"[{', '.join(map(str, spec.shape))}]" if spec.shape and not spec.split else ""
        kind = f"list of {spec.type}{shape}" if spec.ragged else f"{spec.type}{shape}"
        meaning = "; ".join(
            part for part in (spec.meaning, spec.unit, spec.axes and f"{spec.axes} axes") if part
        )
        shown = ", ".join(f"`{part}`" for part in spec.table_names(name))
        yield f"| {shown} | {kind} | {spec.per or 'frame'} | {meaning} |"
