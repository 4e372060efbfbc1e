"""What each stage took: time, memory and bytes; and what it kept and dropped, by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.run_log import RunRecord, last_runs
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.workspace import Workspace


@dataclass(frozen=True)
class StageCost:
    """What a stage took over all drives.

    Attributes:
        stage: Its name.
        shards: Number of its shards.
        frames: Number of their frames; 0 for a stage that is made once for all drives.
        seconds: Time that making them took; None where the log of runs does not hold it.
        peak_mib: Largest resident memory of a process that made one of them; None where the log does not hold it.
        size_bytes: Size of their files.
    """

    stage: str
    shards: int
    frames: int
    seconds: float | None
    peak_mib: float | None
    size_bytes: int

    @property
    def seconds_per_frame(self) -> float | None:
        """Time of a frame; None where that is not known."""
        return None if self.seconds is None or not self.frames else self.seconds / self.frames


@dataclass(frozen=True)
class StageCounts:
    """What a stage counted over all drives, by reason; `dropped` are the reasons that name something left out."""

    stage: str
    kept: tuple[tuple[str, int], ...]
    dropped: tuple[tuple[str, int], ...]


# Reasons whose items go no further: the words by which stages name them in the footers of their shards.
_DROPPED = ("dropped", "left out", "too few", "earlier hypothesis", "cannot be read", "no cluster")
_DROPPED_EXACTLY = ("background", "persistent", "persistent points")


def is_dropped(reason: str) -> bool:
    """Return whether a reason names items that a stage left out."""
    return reason in _DROPPED_EXACTLY or any(part in reason for part in _DROPPED)


def stage_costs(workspace: Workspace, segments: Sequence[str]) -> Iterator[StageCost]:
    """Yield what each stage that has a shard took, in the order of the stages."""
    runs = last_runs(workspace.out)
    for stage in workspace.pipeline.stages:
        paths = {drive: workspace.shard(stage.name, drive) for drive in _drives(stage, segments)}
        footers = {drive: footer for drive, path in paths.items() if (footer := read_footer(path))}
        if not footers:
            continue
        known: list[RunRecord] = [
            runs[stage.name, drive] for drive in footers if (stage.name, drive) in runs
        ]  # a run of some drives elsewhere leaves others without a time
        peaks = [run.peak_mib for run in known if run.peak_mib is not None]
        is_complete = len(known) == len(footers)
        yield StageCost(
            stage=stage.name,
            shards=len(footers),
            frames=0 if stage.is_of_dataset else sum(footer.rows for footer in footers.values()),
            seconds=sum(run.seconds for run in known) if is_complete else None,
            peak_mib=max(peaks) if peaks else None,
            size_bytes=sum(paths[drive].stat().st_size for drive in footers),
        )


def stage_counts(workspace: Workspace, segments: Sequence[str]) -> Iterator[StageCounts]:
    """Yield what each stage kept and dropped, by reason, the most frequent first."""
    for stage in workspace.pipeline.stages:
        counts: Counter[str] = Counter()
        for drive in _drives(stage, segments):
            footer = read_footer(workspace.shard(stage.name, drive))
            counts.update(footer.counts if footer else {})
        if counts:
            ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
            yield StageCounts(
                stage.name,
                tuple(item for item in ordered if not is_dropped(item[0])),
                tuple(item for item in ordered if is_dropped(item[0])),
            )


def _drives(stage: AnyStage, segments: Sequence[str]) -> Sequence[str]:
    return (WHOLE_DATASET,) if stage.is_of_dataset else segments
