"""Status of the shards: fresh, stale or missing, and their size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.run_log import RunRecord, last_runs
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.workspace import Workspace


@dataclass(frozen=True)
class StageStatus:
    """Number and size of the shards of one stage over all segments.

    Attributes:
        stage: Name of the stage.
        fresh: Number of shards made with the present settings and inputs.
        stale: Number of shards made with other ones.
        missing: Number of shards that have not been made.
        rows: Number of rows of the shards that exist.
        size_bytes: Size of their files.
        seconds: Time that making them took when they were last made.
        reason: Why the first stale shard is stale; empty where none is.
    """

    stage: str
    fresh: int
    stale: int
    missing: int
    rows: int
    size_bytes: int
    seconds: float
    reason: str


def status(workspace: Workspace) -> list[StageStatus]:
    """Return the status of each stage, in order; a shard made from one that is not fresh is stale.

    Args:
        workspace: The workspace of the shards.
    """
    states = {segment: dict(_states(workspace, segment)) for segment in workspace.segments}
    runs = last_runs(workspace.out)
    return [_stage_status(workspace, stage, states, runs) for stage in workspace.pipeline.stages]


def _states(workspace: Workspace, segment: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the name, the condition and the reason of each stage of one drive."""
    conditions: dict[str, str] = {}
    for stage in workspace.pipeline.stages:
        condition, reason = state(workspace, stage, WHOLE_DATASET if stage.is_of_dataset else segment)
        not_fresh = [name for name in stage.reads if conditions.get(name, "fresh") != "fresh"]
        if condition == "fresh" and not_fresh:
            condition, reason = "stale", f"{not_fresh[0]} is {conditions[not_fresh[0]]}"
        conditions[stage.name] = condition
        yield stage.name, (condition, reason)


def _stage_status(
    workspace: Workspace,
    stage: AnyStage,
    states: dict[str, dict[str, tuple[str, str]]],
    runs: Mapping[tuple[str, str], RunRecord],
) -> StageStatus:
    of_segment = {segment: all_states[stage.name] for segment, all_states in states.items()}
    if stage.is_of_dataset:
        of_segment = {WHOLE_DATASET: next(iter(of_segment.values()))}
    conditions = [condition for condition, _ in of_segment.values()]
    paths = [workspace.shard(stage.name, segment) for segment in of_segment]
    footers = [footer for footer in map(read_footer, paths) if footer]
    return StageStatus(
        stage=stage.name,
        fresh=conditions.count("fresh"),
        stale=conditions.count("stale"),
        missing=conditions.count("missing"),
        rows=sum(footer.rows for footer in footers),
        size_bytes=sum(path.stat().st_size for path in paths if path.exists()),
        seconds=sum(runs[key].seconds for segment in of_segment if (key := (stage.name, segment)) in runs),
        reason=next((reason for condition, reason in of_segment.values() if condition == "stale"), ""),
    )
