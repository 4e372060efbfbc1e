"""Run stages on segments: open the declared inputs, call, check, write, stamp; skip what is fresh."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.config.base import Config
from upvl_cli.errors import BadSetting, NotMade, OutOfMemory, StorageError, UpvlError
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.provenance import difference, is_of_settings
from upvl_cli.pipeline.run_log import RunRecord, host_name, log_run, settings_digest
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET, Row
from upvl_cli.pipeline.storage.remote_path import RemotePath, is_remote
from upvl_cli.pipeline.tables import read_footer, write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed
from upvl_cli.runtime.parallel import THREADS_VARIABLE
from upvl_cli.runtime.usage import Usage, UsageMeter

Tick = Callable[[], None]


@dataclass(frozen=True)
class Made:
    """What became of one shard: made now, or found fresh."""

    stage: str
    segment: str
    fresh: bool
    rows: int
    counts: Mapping[str, int]
    seconds: float
    peak_mib: float

    @classmethod
    def found_fresh(cls, stage: str, segment: str) -> Made:
        """Return a shard that was found fresh without a look into it."""
        return cls(stage, segment, True, 0, {}, 0.0, 0.0)


def state(
    workspace: Workspace, stage: AnyStage, segment: str, settings: Config | None = None
) -> tuple[str, str]:
    """Return whether a shard is `fresh`, `stale` or `missing`, and why; its inputs are taken to be fresh.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        segment: Name of the drive.
        settings: The values that it should have been made with; None takes those of the TOML file.
    """
    path = workspace.shard(stage.name, segment)
    footer = read_footer(path)
    if footer is None:
        return "missing", "not a whole shard" if path.exists() else "not made"
    stamp = workspace.shard_stamp(stage, segment, settings)
    if footer.stamp == stamp:
        return "fresh", ""
    return "stale", difference(footer.stamp, stamp) or "its stamp is damaged"


def claim_folder(workspace: Workspace, stage: AnyStage, overrides: Mapping[str, object]) -> Config:
    """Return the settings to run a stage with, and mark the output folder as holding them.

    Raises:
        BadSetting: The command line asks for other values than the folder holds.
    """
    settings: Config = workspace.with_values(stage, overrides)
    mark = workspace.out / f"{stage.name}.stamp"
    stamp = workspace.stage_stamp(stage, settings)
    held = mark.read_text(encoding="utf-8", errors="replace") if mark.is_file() else stamp
    if settings != workspace.settings(stage) and held != stamp:
        changes = difference(held, stamp)
        raise BadSetting(
            f"{workspace.out} holds {stage.name} with other values ({changes}); edit "
            f"{workspace.stages / stage.name}.toml to change them for good, or try them beside: "
            f"cp -r {workspace.stages} stages2, edit, then: upvl --stages stages2 --out out2 autolabel --moving-only"
        )
    write_if_changed(mark, stamp)
    return settings


def make_shard(
    workspace: Workspace,
    stage: AnyStage,
    segment: str,
    settings: Config,
    tick: Tick,
    rows_of: Callable[[ShardInputs], Iterator[Row]] | None = None,
) -> Made:
    """Make one shard, or find it fresh.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        segment: Name of the drive.
        settings: Values of the stage.
        tick: Called after each frame.
        rows_of: Yields the rows where they were computed before; None computes them.

    Raises:
        NotMade: An input is missing or was made with other settings.
    """
    prepare_inputs(workspace, stage, segment, settings)
    path = workspace.shard(stage.name, segment)

    def is_stale() -> bool:
        return state(workspace, stage, segment, settings)[0] != "fresh"

    if not is_stale():
        return _fresh(workspace, stage, segment)
    meter = UsageMeter()
    inputs = ShardInputs(workspace, stage, segment, settings, tick)
    if os.environ.get("RANK", "0") != "0":
        return _helped(stage, inputs, settings)
    run = CheckedRows(rows_of(inputs) if rows_of else stage.run(inputs, settings), segment, tick)
    try:
        rows = write(
            path,
            stage.row,
            iter(run),
            stamp=workspace.shard_stamp(stage, segment, settings),
            counts=inputs.counts,
            needed=is_stale,
        )
    except MemoryError as error:
        raise OutOfMemory(
            f"{stage.name} ran out of memory in {segment}, {run.progress}; run it with fewer --workers or "
            f"{THREADS_VARIABLE}=1, or where more memory is free"
        ) from error
    if rows is None:  # another process has made it while this one waited
        return _fresh(workspace, stage, segment)
    _not_older(path, workspace, stage, segment)
    for path_of_no_use in inputs.temporary:
        path_of_no_use.unlink(missing_ok=True)
    usage = meter.read()
    made = Made(stage.name, segment, False, rows, dict(inputs.counts), usage.seconds, usage.peak_mib)
    _log(workspace, stage, made, usage, settings)
    return made


def _helped(stage: AnyStage, inputs: ShardInputs, settings: Config) -> Made:
    """Do the part of a process that `torchrun` started beside the first one, which alone writes.

    Raises:
        BadSetting: The stage is no work for several processes.
    """
    if not stage.distributed:
        raise BadSetting(f"{stage.name} cannot be run by torchrun; run: upvl {stage.name}")
    rows = sum(1 for _ in stage.run(inputs, settings))
    return Made(stage.name, inputs.segment, True, rows, {}, 0.0, 0.0)


def _fresh(workspace: Workspace, stage: AnyStage, segment: str) -> Made:
    path = workspace.shard(stage.name, segment)
    _not_older(path, workspace, stage, segment)
    if isinstance(path, RemotePath):
        path.remove_lease()
    footer = read_footer(path)
    rows, counts = (footer.rows, footer.counts) if footer else (0, {})
    return Made(stage.name, segment, True, rows, counts, 0.0, 0.0)


def _not_older(path: Path, workspace: Workspace, stage: AnyStage, segment: str) -> None:
    """Give a fresh shard a time that make, which knows times only, takes for fresh, whatever the clocks say."""
    if is_remote(path):  # out of the reach of make
        return
    sources = [source for _, source in workspace.sources(stage, segment)]
    sources += [workspace.out / f"{stage.name}.{kind}" for kind in ("stamp", "files")]
    newest_ns = max(source.stat().st_mtime_ns for source in sources if source.exists())
    if path.stat().st_mtime_ns < newest_ns:
        os.utime(path, ns=(newest_ns, newest_ns))


class CheckedRows:
    """The rows of a stage, each checked to be of the segment and after the one before."""

    def __init__(self, rows: Iterator[Row], segment: str, tick: Tick) -> None:
        self._rows, self._segment, self._tick = rows, segment, tick
        self._last = -1

    @property
    def progress(self) -> str:
        """How far the stage came, in words."""
        return "before its first frame was done" if self._last < 0 else f"after frame {self._last}"

    def __iter__(self) -> Iterator[Row]:
        for row in self._rows:
            if row.segment != self._segment or row.frame <= self._last:
                raise ValueError(
                    f"row ({row.segment}, {row.frame}) after frame {self._last} of {self._segment}"
                )
            self._last = row.frame
            yield row
            self._tick()


def prepare_inputs(workspace: Workspace, stage: AnyStage, segment: str, settings: Config) -> None:
    """Write the marks of what no stage makes, and check that what a shard is made from is fresh.

    Raises:
        NotMade: An input is missing or was made with other settings.
    """
    _mark_given(workspace, stage, segment, settings)
    _check_inputs(workspace, stage, segment, settings)


def _mark_given(workspace: Workspace, stage: AnyStage, segment: str, settings: Config | None) -> None:
    """Write the marks of what no stage makes."""
    if "vlm" in stage.reads:
        workspace.mark_model()
    for drive in workspace.drives_of(stage, settings) if stage.is_of_dataset else (segment,):
        try:
            workspace.mark_raw(drive)
        except UpvlError:
            if not stage.is_of_dataset:  # what is made of all drives is made of those that can be read
                raise


def _check_inputs(workspace: Workspace, stage: AnyStage, segment: str, settings: Config | None) -> None:
    for source, path in workspace.sources(stage, segment, settings):
        name, _, drive = source.partition("/")
        if name in NOT_MADE:
            continue
        maker = workspace.pipeline.by_name[name]
        condition, reason = state(
            workspace, maker, WHOLE_DATASET if maker.is_of_dataset else drive or segment
        )
        if condition != "fresh":
            # Options of a command hold for that run alone: who gave some may want to keep what they made.
            keep = "; to keep it, write the values left of -> in stages" if is_of_settings(reason) else ""
            raise NotMade(
                f"{stage.name} needs {path}, which is {condition} ({reason}); "
                f"run: upvl {name}, or: make {stage.name}{keep}"
            )


def _log(workspace: Workspace, stage: AnyStage, made: Made, usage: Usage, settings: Config) -> None:
    """Keep what a shard took, outside the shard: no clock in files that must be the same twice."""
    sources = workspace.sources(stage, made.segment, settings)
    # Of objects each size is a request, and what is read of them is not all.
    read = [] if is_remote(workspace.out) else [path for name, path in sources if name not in NOT_MADE]
    record = RunRecord(
        stage=made.stage,
        segment=made.segment,
        rows=made.rows,
        seconds=usage.seconds,
        cpu_s=usage.cpu_s,
        gpu_s=usage.gpu_s,
        peak_mib=round(usage.peak_mib),
        size_bytes=_size_of(workspace.shard(made.stage, made.segment)),
        read_bytes=sum(_size_of(path) or 0 for path in read),
        host=host_name(),
        end=time.time(),
        settings=settings_digest(workspace.stage_stamp(stage, settings)),
    )
    log_run(workspace.out, record)


def _size_of(path: Path) -> int | None:
    """Return the size of a file or an object; None where it cannot be seen."""
    try:
        return path.stat().st_size
    except (OSError, StorageError):
        return None
