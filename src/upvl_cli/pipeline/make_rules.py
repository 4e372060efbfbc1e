"""The rules that make follows, from the declarations of the stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.pipeline import AnyStage, Pipeline
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed

# GNU make 4.3 takes 6 s and 0.2 GB to look at all targets of 5 000 drives, and 26 s and 0.9 GB for these.
MOST_DRIVES = 20_000


def write_rules(workspace: Workspace) -> Path:
    """Write the marks that make compares and the rules that it follows; return the path of the rules.

    A mark is rewritten only where it would differ, so a comment or a touch remakes nothing.

    Raises:
        BadSetting: The shards are out of the reach of make, or there are too many of them.
    """
    _check_reach(workspace)
    for segment in workspace.segments:
        workspace.mark_raw(segment)
    workspace.mark_model()
    pipeline = workspace.pipeline
    for stage in pipeline.stages:
        write_if_changed(workspace.out / f"{stage.name}.stamp", workspace.stage_stamp(stage))
        if stage.has_files:
            digests = [workspace.files_digest(stage, segment) for segment in workspace.segments]
            write_if_changed(workspace.out / f"{stage.name}.files", "\n".join(digests))
    path = workspace.out / "rules.mk"
    drives = {stage.name: workspace.drives_of(stage) for stage in pipeline.stages if stage.is_of_dataset}
    write_if_changed(path, rules(pipeline, workspace.segments, drives))
    return path


def _check_reach(workspace: Workspace) -> None:
    remedy = "run upvl autolabel with --on, or give the tasks of upvl plan --next 1000 to a scheduler"
    if is_remote(workspace.out):
        raise BadSetting(
            f"{workspace.out} is out of the reach of make, which asks for the dates of files; {remedy}"
        )
    if (drives := len(workspace.segments)) > MOST_DRIVES:
        raise BadSetting(f"{drives} drives are too many for make, which has up to {MOST_DRIVES}; {remedy}")


def rules(pipeline: Pipeline, segments: Sequence[str], drives: Mapping[str, Sequence[str]]) -> str:
    """Return the rules, one for each stage over all segments.

    Args:
        pipeline: The stages, in order.
        segments: Names that are safe as words of make.
        drives: For each stage of the whole dataset the drives that it is made from.
    """
    lines = ["# Made by: upvl plan", f"SEGMENTS := {' '.join(segments)}", ""]
    # A drive with a fault is not labelled; make ANYWAY=--anyway labels it all the same.
    lines += ["$(OUT)/check/%.ok: $(OUT)/raw/%.stamp", "\t@$(UPVL) check --quick $(ANYWAY) $*", ""]
    for stage in pipeline.stages:
        lines += [f".PHONY: {stage.name}", *_rule(stage, drives), ""]
    # Shards of middle stages are what a resumed run starts from: make must delete none, nor any on Ctrl-C.
    shards = " ".join(f"$(OUT)/{stage.name}/%.parquet" for stage in pipeline.stages)
    labelling = " ".join(stage.name for stage in pipeline.labelling_stages)
    lines += [
        f"LABELLING := {labelling}",
        ".PHONY: autolabel",
        "autolabel: $(LABELLING)",
        "\t@$(UPVL) summary",
    ]
    lines += [".SECONDARY:", f".PRECIOUS: {shards}", ""]
    return "\n".join(lines)


def _rule(stage: AnyStage, drives: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the rule of one stage; `drives` are those of each stage that is made once for the whole dataset."""

    def source(name: str) -> str:
        if name == "vlm":
            return "$(OUT)/vlm.stamp"
        if name in drives:
            return f"$(OUT)/{name}/{WHOLE_DATASET}.parquet"
        of_drive = f"$(OUT)/{name}/%.{'stamp' if name == 'raw' else 'parquet'}"
        return (
            " ".join(of_drive.replace("%", drive) for drive in drives[stage.name])
            if stage.is_of_dataset
            else of_drive
        )

    made_from = " ".join([f"$(OUT)/{stage.name}.stamp", *map(source, stage.reads)])
    if stage.has_files:
        made_from += f" $(OUT)/{stage.name}.files"
    if set(stage.reads) <= set(NOT_MADE) and not stage.is_of_dataset:
        made_from += " | $(OUT)/check/%.ok"  # the order alone: what was found does not make a shard stale
    if stage.is_of_dataset:
        shard = f"$(OUT)/{stage.name}/{WHOLE_DATASET}.parquet"
        return [f"{stage.name}: {shard}", f"{shard}: {made_from}", f"\t@$(UPVL) {stage.name}"]
    return [
        f"{stage.name}: $(SEGMENTS:%=$(OUT)/{stage.name}/%.parquet)",
        f"$(OUT)/{stage.name}/%.parquet: {made_from}",
        f"\t@$(UPVL) {stage.name} --segment $*",
    ]
