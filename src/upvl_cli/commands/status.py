"""Status of the shards: fresh, stale or missing, and their size."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.errors import BadInput
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.freshness import Freshness
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.run_table import stage_runs
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import WHOLE_DATASET
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


def status(workspace: Workspace, reading: Reading | None = None) -> list[StageStatus]:
    """Return the status of each stage, in order; a shard made from one that is not fresh is stale.

    Args:
        workspace: The workspace of the shards.
        reading: What to do about shards that the catalogue does not know.
    """
    found = Freshness(workspace, reading=reading)
    names = [WHOLE_DATASET, *workspace.segments]
    runs = {stage: all_runs.of_segments(names) for stage, all_runs in stage_runs(workspace.out).items()}
    seconds = {stage: float(last.column("seconds").sum()) for stage, last in runs.items()}
    return [
        _stage_status(workspace, stage, found, seconds.get(stage.name, 0.0))
        for stage in workspace.pipeline.stages
    ]


def _stage_status(workspace: Workspace, stage: AnyStage, found: Freshness, seconds: float) -> StageStatus:
    condition = found.stages[stage.name]
    stale = ~condition.fresh & ~condition.missing
    return StageStatus(
        stage=stage.name,
        fresh=int(condition.fresh.sum()),
        stale=int(stale.sum()),
        missing=int(condition.missing.sum()),
        rows=condition.rows,
        size_bytes=condition.size_bytes,
        seconds=seconds,
        reason=_reason(workspace, stage, found, int(stale.argmax())) if stale.any() else "",
    )


def _reason(workspace: Workspace, stage: AnyStage, found: Freshness, place: int) -> str:
    """Return why a shard is stale, from its own footer and those of its inputs."""
    try:
        segment = WHOLE_DATASET if stage.is_of_dataset else found.segments[place]
        condition, reason = state(workspace, stage, segment)
    except BadInput as error:
        return str(error)
    return reason if condition != "fresh" else found.input_not_fresh(stage, place)
