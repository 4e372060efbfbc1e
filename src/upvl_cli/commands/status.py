"""Status of the shards: fresh, stale or missing, and their size."""

from __future__ import annotations

import contextlib
import json
from collections import defaultdict
from dataclasses import dataclass

from upvl_cli.errors import BadInput
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.freshness import Freshness
from upvl_cli.pipeline.pipeline import AnyStage
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


@dataclass(frozen=True)
class LastRun:
    """What making a shard took when it was last made.

    Attributes:
        seconds: Elapsed time.
        peak_mib: Largest resident memory that the process had reached by then, stages before it in the same process
            included; None where the log does not hold it.
    """

    seconds: float
    peak_mib: float | None


def status(workspace: Workspace, reading: Reading | None = None) -> list[StageStatus]:
    """Return the status of each stage, in order; a shard made from one that is not fresh is stale.

    Args:
        workspace: The workspace of the shards.
        reading: What to do about shards that the catalogue does not know.
    """
    found = Freshness(workspace, reading=reading)
    known = {WHOLE_DATASET, *workspace.segments}
    seconds: defaultdict[str, float] = defaultdict(float)
    for (stage, segment), run in last_runs(workspace).items():
        seconds[stage] += run.seconds if segment in known else 0.0
    return [
        _stage_status(workspace, stage, found, seconds[stage.name]) for stage in workspace.pipeline.stages
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


def last_runs(workspace: Workspace) -> dict[tuple[str, str], LastRun]:
    """Return the last run of each stage and segment, of `out/runs.jsonl`; lines that a kill cut short are skipped."""
    try:
        lines = (workspace.out / "runs.jsonl").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    runs: dict[tuple[str, str], LastRun] = {}
    for line in lines:
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
            run = json.loads(line)
            peak_mib = run.get("peak_mib")
            key = str(run["stage"]), str(run["segment"])
            runs[key] = LastRun(float(run["seconds"]), None if peak_mib is None else float(peak_mib))
    return runs
