"""What the shards of a workspace took, beside what was estimated for as many frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from upvl_cli.commands.cost_estimate import CostEstimate, Prices, StageEstimate
from upvl_cli.commands.estimate_cost import cpu_s, size_bytes
from upvl_cli.pipeline.run_log import RunRecord, last_runs, read_runs
from upvl_cli.pipeline.workspace import Workspace

_HOUR_S = 3600.0


@dataclass(frozen=True)
class TrueCost:
    """What the shards of one stage took when they were last made, or those of all stages.

    Attributes:
        stage: Name of the stage.
        shards: Number of its shards.
        cpu_h: Hours of processor time.
        gpu_h: Hours in which a GPU was held.
        peak_mib: Largest resident memory of a process that made one of them; None where the log does not hold it.
        size_bytes: Size of the shards.
        estimated: What was estimated for as many frames; None where nothing was.
    """

    stage: str
    shards: int
    cpu_h: float
    gpu_h: float
    peak_mib: float | None
    size_bytes: float
    estimated: StageEstimate | None


@dataclass(frozen=True)
class TrueCosts:
    """What the shards of a workspace took.

    Attributes:
        stages: Of each stage, in order.
        total: Of those stages that were estimated; of all where none was.
        again_cpu_h: Hours of processor time of runs whose shards were made again later.
        cost: What the total costs; None without prices.
    """

    stages: tuple[TrueCost, ...]
    total: TrueCost
    again_cpu_h: float
    cost: float | None


def true_costs(workspace: Workspace, estimate: CostEstimate | None) -> TrueCosts:
    """Return what the shards took, by the run log.

    Args:
        workspace: The workspace of the shards.
        estimate: What was estimated before; None where nothing was.
    """
    last = last_runs(workspace.out)
    all_cpu_s = sum(map(cpu_s, read_runs(workspace.out)))
    of_stage: dict[str, list[RunRecord]] = {stage.name: [] for stage in workspace.pipeline.stages}
    for run in last.values():
        if run.stage in of_stage:  # a stage of a newer version, or of none
            of_stage[run.stage].append(run)
    expected = {} if estimate is None else {stage.stage: stage for stage in estimate.stages}
    stages = tuple(
        _true_cost(workspace, name, runs, expected.get(name)) for name, runs in of_stage.items() if runs
    )
    compared = [stage for stage in stages if stage.estimated] or stages
    prices = Prices() if estimate is None else estimate.prices
    total = _total(compared)
    return TrueCosts(
        stages=stages,
        total=total,
        again_cpu_h=max(0.0, all_cpu_s - sum(map(cpu_s, last.values()))) / _HOUR_S,
        cost=prices.cost(total.cpu_h, total.gpu_h, total.size_bytes),
    )


def _true_cost(
    workspace: Workspace, stage: str, runs: list[RunRecord], expected: StageEstimate | None
) -> TrueCost:
    share = 1.0
    if expected is not None and expected.frames:
        share = sum(run.rows for run in runs) / expected.frames
    return TrueCost(
        stage=stage,
        shards=len(runs),
        cpu_h=sum(map(cpu_s, runs)) / _HOUR_S,
        gpu_h=sum(run.gpu_s for run in runs) / _HOUR_S,
        peak_mib=_largest(run.peak_mib for run in runs),
        size_bytes=float(sum(size_bytes(workspace, run) for run in runs)),
        estimated=None if expected is None else expected.scaled(share),
    )


def _total(stages: Iterable[TrueCost]) -> TrueCost:
    stages = list(stages)
    estimated = [stage.estimated for stage in stages if stage.estimated]
    return TrueCost(
        stage="all",
        shards=sum(stage.shards for stage in stages),
        cpu_h=sum(stage.cpu_h for stage in stages),
        gpu_h=sum(stage.gpu_h for stage in stages),
        peak_mib=_largest(stage.peak_mib for stage in stages),
        size_bytes=sum(stage.size_bytes for stage in stages),
        estimated=StageEstimate.sum("all", estimated) if estimated else None,
    )


def _largest(peaks: Iterable[float | None]) -> float | None:
    return max((peak for peak in peaks if peak is not None), default=None)
