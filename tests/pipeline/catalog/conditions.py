"""The condition of each shard, asked one by one and by arrays."""

from __future__ import annotations

from upvl_cli.errors import BadInput
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.freshness import Freshness
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

Conditions = dict[tuple[str, str], str]


def run(workspace: Workspace) -> None:
    list(run_all(workspace, workspace.pipeline.stages, workspace.segments, overrides={}))


def one_by_one(workspace: Workspace) -> Conditions:
    """The plain answer: each shard asked for itself, and stale where one that it was made from is not fresh."""
    found: Conditions = {}
    for stage in workspace.pipeline.stages:
        for segment in [WHOLE_DATASET] if stage.is_of_dataset else workspace.segments:
            try:
                condition, _ = state(workspace, stage, segment)
            except BadInput:
                condition = "stale"
            for name, path in workspace.sources(stage, segment):
                of_input = found.get((name.partition("/")[0], path.stem), "fresh")
                if condition == "fresh" and of_input != "fresh":
                    condition = "stale"
            found[stage.name, segment] = condition
    return found


def by_arrays(workspace: Workspace, **reading: object) -> Conditions:
    found = Freshness(workspace, reading=Reading(**{"least_new": 1, **reading}))  # type: ignore[arg-type]
    conditions: Conditions = {}
    for stage in workspace.pipeline.stages:
        of_stage = found.stages[stage.name]
        names = [WHOLE_DATASET] if stage.is_of_dataset else workspace.segments
        for place, segment in enumerate(names):
            fresh, missing = of_stage.fresh[place], of_stage.missing[place]
            conditions[stage.name, segment] = "fresh" if fresh else "missing" if missing else "stale"
    return conditions
