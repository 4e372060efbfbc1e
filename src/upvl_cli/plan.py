"""What follows from the declarations: make's rules, and the page that documents the stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from upvl_cli.datasets.city.settings import CityParams
from upvl_cli.evaluation.params import EvalParams
from upvl_cli.querying.params import QueryParams
from upvl_cli.settings import load
from upvl_cli.stage import Stage, columns_of, params_of
from upvl_cli.stages import LABELLING, STAGES
from upvl_cli.workspace import WHOLE, RawParams, VlmParams, Workspace, write_if_changed


def plan(workspace: Workspace) -> Path:
    """Write the marks that make compares and the rules that it follows; returns the rules' path.

    A mark is rewritten only where it would differ, so a comment or a touch remakes nothing.
    """
    for segment in workspace.segments:
        workspace.mark_raw(segment)
    workspace.mark_model()
    for stage in STAGES:
        write_if_changed(workspace.out / f"{stage.name}.stamp", workspace.stage_stamp(stage))
    path = workspace.out / "rules.mk"
    drives = {stage.name: workspace.drives_of(stage) for stage in STAGES if stage.whole}
    write_if_changed(path, rules(STAGES, workspace.segments, drives))
    return path


def rules(stages: Sequence[Stage], segments: Sequence[str], drives: Mapping[str, Sequence[str]]) -> str:
    """The rules: one for each stage, over all segments.

    Args:
        stages: The stages, in order.
        segments: Names that are safe as words of make.
        drives: What each stage that is made once is made from.
    """
    lines = ["# Made by: upvl plan", f"SEGMENTS := {' '.join(segments)}", ""]
    for stage in stages:
        lines += [f".PHONY: {stage.name}", *_rule(stage, drives), ""]
    # Shards of middle stages are what a resumed run starts from: make must delete none, nor any on Ctrl-C.
    shards = " ".join(f"$(OUT)/{stage.name}/%.parquet" for stage in stages)
    labels = " ".join(stage.name for stage in LABELLING)
    lines += [".PHONY: labels", f"labels: {labels}", ".SECONDARY:", f".PRECIOUS: {shards}", ""]
    return "\n".join(lines)


def _rule(stage: Stage, drives: Mapping[str, Sequence[str]]) -> list[str]:
    """The rule of one stage; `drives` are those of each stage that is made once."""

    def source(name: str) -> str:
        if name == "vlm":
            return "$(OUT)/vlm.stamp"
        if name in drives:
            return f"$(OUT)/{name}/{WHOLE}.parquet"
        of_drive = f"$(OUT)/{name}/%.{'stamp' if name == 'raw' else 'parquet'}"
        return (
            " ".join(of_drive.replace("%", drive) for drive in drives[stage.name])
            if stage.whole
            else of_drive
        )

    made_from = " ".join([f"$(OUT)/{stage.name}.stamp", *map(source, stage.reads)])
    if stage.whole:
        shard = f"$(OUT)/{stage.name}/{WHOLE}.parquet"
        return [f"{stage.name}: {shard}", f"{shard}: {made_from}", f"\t@$(UPVL) {stage.name}"]
    return [
        f"{stage.name}: $(SEGMENTS:%=$(OUT)/{stage.name}/%.parquet)",
        f"$(OUT)/{stage.name}/%.parquet: {made_from}",
        f"\t@$(UPVL) {stage.name} --segment $*",
    ]


def page(stages: Sequence[Stage], folder: Path) -> str:
    """The page that documents the stages, from their declarations and their values.

    Args:
        stages: The stages, in order.
        folder: Folder of the TOML files whose values are shown.
    """
    lines = [
        "# The pipeline",
        "",
        "Made by `make docs` from the declarations in `src/upvl_cli/stages/`; a test compares the two.",
        "",
        *_section("raw", "Names the drives.", (), RawParams, folder),
        *_section("vlm", "Names the vision-language model.", (), VlmParams, folder),
        *_section("synthetic", "Makes the built-in drives, where `raw` names them.", (), CityParams, folder),
    ]
    for stage in stages:
        lines += _section(stage.name, stage.summary, stage.reads, stage.params, folder)
        lines += ["| column | type | one for each | meaning |", "| --- | --- | --- | --- |"]
        for name, spec in columns_of(stage.row).items():
            shape = f"[{', '.join(map(str, spec.shape))}]" if spec.shape else ""
            meaning = "; ".join(
                part for part in (spec.meaning, spec.unit, spec.axes and f"{spec.axes} axes") if part
            )
            lines.append(f"| `{name}` | {spec.type}{shape} | {spec.per or 'frame'} | {meaning} |")
        lines.append("")
    lines += _section(
        "query", "Finds objects by words, in drives that need no picture.", (), QueryParams, folder
    )
    lines += _section(
        "eval", "Scores labels, tracks and flow where the truth is known.", (), EvalParams, folder
    )
    return "\n".join(lines)


def _section(name: str, summary: str, reads: Sequence[str], settings: type, folder: Path) -> list[str]:
    values = load(settings, folder / f"{name}.toml")
    lines = [f"## {name}", "", summary]
    lines += ["", f"Reads {', '.join(f'`{source}`' for source in reads)}."] if reads else []
    lines.append("")
    declared = params_of(settings)
    if declared:
        lines += ["| setting | value | range | meaning |", "| --- | --- | --- | --- |"]
    for key, (_, spec) in declared.items():
        value = f"`{getattr(values, key)!r}`{' ' + spec.unit if spec.unit else ''}"
        lines.append(f"| `{key}` | {value} | {spec.bounds} | {spec.meaning} |")
    return [*lines, ""] if declared else lines
