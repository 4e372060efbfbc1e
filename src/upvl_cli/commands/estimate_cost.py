"""Estimate what labelling many drives takes, from the run log of a few that have been labelled."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from upvl_cli.commands.cost_estimate import NO_PRICES, CostEstimate, Prices, StageEstimate
from upvl_cli.commands.cost_range import CostRange, from_sample
from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.run_log import RunRecord, last_runs, settings_digest
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

# Drives that are opened to see how long they are, and for how long: opening each of an archive would take hours.
OPENED_DRIVES = 32
OPENING_S = 20.0
# Two runs of the same work on the same machine differ by some percent: no range is narrower.
SMALLEST_ERROR = math.log(1.1)
_HOUR_S = 3600.0

Runs = Mapping[tuple[str, str], RunRecord]


@dataclass(frozen=True)
class _Lengths:
    """How long the drives are.

    Attributes:
        frames: Frames of all of them.
        longest: Frames of the longest that is known.
        known: Number of drives whose length is known.
        error: Standard error of `frames` as a share of it; 0 where all lengths are known.
    """

    frames: float
    longest: int
    known: int
    error: float


def sampled_drives(workspace: Workspace, runs: Runs | None = None) -> tuple[str, ...]:
    """Return the drives whose runs of every labelling stage are in the log, with the present settings."""
    stages = [stage for stage in workspace.pipeline.labelling_stages if not stage.is_of_dataset]
    known = _present_runs(workspace, last_runs(workspace.out) if runs is None else runs)
    return tuple(
        drive for drive in workspace.segments if all((stage.name, drive) in known for stage in stages)
    )


def drives_to_sample(workspace: Workspace, count: int) -> tuple[str, ...]:
    """Return the drives to label so that an estimate has that many, spread evenly over the names."""
    sampled = set(sampled_drives(workspace))
    left = [drive for drive in workspace.segments if drive not in sampled]
    missing = min(max(0, count - len(sampled)), len(left))
    return tuple(left[(2 * place + 1) * len(left) // (2 * missing)] for place in range(missing))


def estimate_cost(
    workspace: Workspace,
    *,
    drives: int | None = None,
    sample: Sequence[str] | None = None,
    workers: int = 1,
    prices: Prices = NO_PRICES,
) -> CostEstimate:
    """Return what labelling drives takes.

    Args:
        workspace: The workspace, whose run log holds the runs of a sample.
        drives: Number of drives; None for those of the workspace.
        sample: Names of the sampled drives; None takes all that the log holds with the present settings.
        workers: Number of workers that work at once, each like those that made the sample.
        prices: What the user pays.

    Raises:
        BadSetting: Fewer than two drives are in the sample.
    """
    runs = _present_runs(workspace, last_runs(workspace.out))
    chosen = tuple(sampled_drives(workspace, runs) if sample is None else sample)
    if len(chosen) < 2:
        raise BadSetting(f"an estimate needs two labelled drives, {workspace.out} holds {len(chosen)}")
    count = len(workspace.segments) if drives is None else drives
    lengths = _lengths(workspace, runs, chosen, count)
    stages = [
        found
        for stage in workspace.pipeline.stages
        if (found := _stage_estimate(workspace, stage, runs, chosen, lengths, count))
    ]
    parts = [found for found in stages if found.frames]
    once = [found for found in stages if not found.frames]
    of_drives = _sum_of_drives(workspace, runs, [found.stage for found in parts], chosen, lengths, count)
    total = StageEstimate.sum("all", [of_drives, *once])
    longest = lengths.longest / lengths.frames
    wall_h = CostRange.sum(found.elapsed_h for found in once) + of_drives.elapsed_h * max(
        1 / workers, longest
    )
    ends = [
        prices.cost(total.cpu_h.at(end), total.gpu_h.at(end), total.size_bytes.at(end))
        for end in ("low", "mean", "high")
    ]
    return CostEstimate(
        drives=count,
        frames=lengths.frames,
        opened=lengths.known,
        sample=chosen,
        workers=workers,
        prices=prices,
        stages=tuple(stages),
        total=total,
        wall_h=wall_h,
        cost=CostRange(*(end or 0.0 for end in ends)) if prices != NO_PRICES else None,
        has_cpu_time=all(run.cpu_s is not None for run in runs.values() if run.segment in chosen),
    )


def cpu_s(run: RunRecord) -> float:
    """Return the processor time of a run; its elapsed time where the log does not hold it."""
    return run.seconds if run.cpu_s is None else run.cpu_s


def size_bytes(workspace: Workspace, run: RunRecord) -> int:
    """Return the size of the shard of a run; that of its file where the log does not hold it."""
    if run.size_bytes is not None:
        return run.size_bytes
    path = workspace.shard(run.stage, run.segment)
    return path.stat().st_size if path.exists() else 0


def _present_runs(workspace: Workspace, runs: Runs) -> dict[tuple[str, str], RunRecord]:
    """Return the runs with the present settings; older logs do not say with which, and are taken as they are."""
    digests = {
        stage.name: settings_digest(workspace.stage_stamp(stage))
        for stage in workspace.pipeline.stages
        if any(name == stage.name and run.settings for (name, _), run in runs.items())
    }
    return {key: run for key, run in runs.items() if run.settings in ("", digests.get(key[0], ""))}


def _lengths(workspace: Workspace, runs: Runs, sample: Sequence[str], count: int) -> _Lengths:
    """Return how long drives are: those of the sample, and some that are opened, evenly spread."""
    first = next(stage for stage in workspace.pipeline.labelling_stages if not stage.is_of_dataset)
    known = {drive: runs[first.name, drive].rows for drive in sample}
    names = workspace.segments
    step = max(1, len(names) // OPENED_DRIVES)
    started = time.monotonic()
    for drive in names[::step]:
        if time.monotonic() - started > OPENING_S:
            break
        try:
            known.setdefault(drive, len(workspace.drive(drive).frames))
        except UpvlError:
            continue  # a drive that cannot be read will not be labelled either
    frames = list(known.values())
    if count == len(names) == len(known):
        return _Lengths(max(1.0, sum(frames)), max(frames), count, 0.0)
    mean = max(1.0, statistics.fmean(frames))
    error = statistics.stdev(frames) / mean / math.sqrt(len(frames))
    return _Lengths(mean * count, max(frames), len(frames), error)


def _stage_estimate(
    workspace: Workspace,
    stage: AnyStage,
    runs: Runs,
    sample: Sequence[str],
    lengths: _Lengths,
    drives: int,
) -> StageEstimate | None:
    """Return what one stage takes; None where the log does not hold it for every drive of the sample."""
    if not stage.is_of_dataset:
        if not all((stage.name, drive) in runs for drive in sample):
            return None
        return _sum_of_drives(workspace, runs, [stage.name], sample, lengths, drives)
    run = runs.get((stage.name, WHOLE_DATASET))
    if run is None:
        return None
    return StageEstimate(
        stage.name, 0.0,
        cpu_h=CostRange.about(cpu_s(run) / _HOUR_S, SMALLEST_ERROR),
        gpu_h=CostRange.about(run.gpu_s / _HOUR_S, SMALLEST_ERROR),
        elapsed_h=CostRange.about(run.seconds / _HOUR_S, SMALLEST_ERROR),
        peak_mib=run.peak_mib,
        size_bytes=CostRange.about(size_bytes(workspace, run), 0.0),
    )  # fmt: skip


def _sum_of_drives(
    workspace: Workspace,
    runs: Runs,
    stages: Sequence[str],
    sample: Sequence[str],
    lengths: _Lengths,
    drives: int,
) -> StageEstimate:
    """Return what some stages of each drive take together, whose shares of a drive vary together."""
    frames = [max(1, runs[stages[0], drive].rows) for drive in sample]
    of_drive = [[runs[stage, drive] for stage in stages] for drive in sample]

    def scaled(values: list[float]) -> CostRange:
        return from_sample(
            values, frames, lengths.frames, drives=drives, length_error=lengths.error, smallest=SMALLEST_ERROR
        )

    peaks = [run.peak_mib for found in of_drive for run in found if run.peak_mib is not None]
    return StageEstimate(
        stages[0] if len(stages) == 1 else "all", lengths.frames,
        cpu_h=scaled([sum(map(cpu_s, found)) / _HOUR_S for found in of_drive]),
        gpu_h=scaled([sum(run.gpu_s for run in found) / _HOUR_S for found in of_drive]),
        elapsed_h=scaled([sum(run.seconds for run in found) / _HOUR_S for found in of_drive]),
        peak_mib=max(peaks, default=None),
        size_bytes=scaled([float(sum(size_bytes(workspace, run) for run in found)) for found in of_drive]),
    )  # fmt: skip
