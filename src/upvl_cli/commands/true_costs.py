"""What the shards of a workspace took, beside what was estimated for as many frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upvl_cli.commands.cost_estimate import CostEstimate, Prices, StageEstimate
from upvl_cli.pipeline.run_table import StageRuns, stage_runs
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

_HOUR_S = 3600.0
_ROUNDING_S = 1e-3  # two sums of the same times differ by rounding


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
    runs = stage_runs(workspace.out)
    expected = {} if estimate is None else {stage.stage: stage for stage in estimate.stages}
    stages = tuple(
        _true_cost(workspace, stage.name, runs[stage.name], expected.get(stage.name))
        for stage in workspace.pipeline.stages
        if stage.name in runs
    )
    prices = Prices() if estimate is None else estimate.prices
    total = _total([stage for stage in stages if stage.estimated] or stages)
    again_cpu_s = sum(found.all_cpu_s - float(found.cpu_s.sum()) for found in runs.values())
    return TrueCosts(
        stages=stages,
        total=total,
        again_cpu_h=again_cpu_s / _HOUR_S if again_cpu_s > _ROUNDING_S else 0.0,
        cost=prices.cost(total.cpu_h, total.gpu_h, total.size_bytes),
    )


def _true_cost(workspace: Workspace, stage: str, runs: StageRuns, expected: StageEstimate | None) -> TrueCost:
    share = 1.0
    if expected is not None and expected.frames:
        share = float(runs.column("rows").sum()) / expected.frames
    peaks_mib, gpu_s = runs.column("peak_mib"), runs.column("gpu_s")
    return TrueCost(
        stage=stage,
        shards=len(runs.numbers),
        cpu_h=float(runs.cpu_s.sum()) / _HOUR_S,
        gpu_h=float(gpu_s[gpu_s > 0].sum()) / _HOUR_S,
        peak_mib=float(peaks_mib[peaks_mib > 0].max(initial=0.0)) or None,
        size_bytes=_size_bytes(workspace, stage, runs),
        estimated=None if expected is None else expected.scaled(share),
    )


def _size_bytes(workspace: Workspace, stage: str, runs: StageRuns) -> float:
    """Return the size of the shards of a stage; that of the files where an older log does not hold it."""
    sizes = runs.column("size_bytes")
    if (sizes >= 0).all():
        return float(sizes.sum())
    paths = [workspace.shard(stage, name) for name in (WHOLE_DATASET, *workspace.segments)]
    return float(sum(path.stat().st_size for path in paths if path.exists()))


def _total(stages: Sequence[TrueCost]) -> TrueCost:
    estimated = [stage.estimated for stage in stages if stage.estimated]
    peaks_mib = [stage.peak_mib for stage in stages if stage.peak_mib is not None]
    return TrueCost(
        stage="all",
        shards=sum(stage.shards for stage in stages),
        cpu_h=sum(stage.cpu_h for stage in stages),
        gpu_h=sum(stage.gpu_h for stage in stages),
        peak_mib=max(peaks_mib, default=None),
        size_bytes=sum(stage.size_bytes for stage in stages),
        estimated=StageEstimate.sum("all", estimated) if estimated else None,
    )
