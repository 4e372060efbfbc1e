"""Runs stages on segments: opens declared inputs, calls, checks, writes, stamps; skips what is fresh."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadSetting, NotMade, UpvlError
from upvl_cli.inputs import Inputs
from upvl_cli.parallel import THREADS_VARIABLE, threads
from upvl_cli.settings import load
from upvl_cli.stage import Row, Stage
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import read_footer, write
from upvl_cli.workspace import Workspace, difference, write_if_changed

Tick = Callable[[], None]


@dataclass(frozen=True)
class Made:
    """What became of one shard."""

    stage: str
    segment: str
    fresh: bool
    rows: int
    counts: Mapping[str, int]
    seconds: float
    peak_mib: float


def state(workspace: Workspace, stage: Stage, segment: str, settings: Any = None) -> tuple[str, str]:
    """Whether a shard is `fresh`, `stale` or `missing`, and why; trusts that its inputs are fresh.

    Args:
        workspace: Where.
        stage: Whose shard.
        segment: Of which drive.
        settings: The values it should have been made with; None takes those of the TOML file.
    """
    path = workspace.shard(stage.name, segment)
    footer = read_footer(path)
    if footer is None:
        return "missing", "not a whole shard" if path.exists() else "not made"
    stamp = workspace.shard_stamp(stage, segment, settings)
    if footer.stamp != stamp:
        return "stale", difference(footer.stamp, stamp)
    made_ns = path.stat().st_mtime_ns
    for name in stage.reads:
        source = workspace.shard(name, segment)
        if source.exists() and source.stat().st_mtime_ns > made_ns:
            return "stale", f"{name} is newer"
    return "fresh", ""


def claim_folder(workspace: Workspace, stage: Stage, overrides: Mapping[str, Any]) -> Any:
    """The settings to run a stage with; the output folder is marked as holding them.

    Raises:
        BadSetting: The command line asks for other values than the folder holds.
    """
    settings = load(stage.params, workspace.stages / f"{stage.name}.toml", overrides)
    mark = workspace.out / f"{stage.name}.stamp"
    stamp = workspace.stage_stamp(stage, settings)
    if settings != workspace.settings(stage) and mark.exists() and mark.read_text(encoding="utf-8") != stamp:
        changes = difference(mark.read_text(encoding="utf-8"), stamp)
        raise BadSetting(
            f"{workspace.out} holds {stage.name} with other values ({changes}); edit "
            f"{workspace.stages / stage.name}.toml to change them for good, or try them beside: "
            f"cp -r {workspace.stages} stages2, edit, then: upvl --stages stages2 --out out2 autolabel --moving-only"
        )
    write_if_changed(mark, stamp)
    return settings


def make_shard(workspace: Workspace, stage: Stage, segment: str, settings: Any, tick: Tick) -> Made:
    """Make one shard, or find it fresh.

    Args:
        workspace: Where.
        stage: What to make.
        segment: Of which drive.
        settings: The values to make it with.
        tick: Called after each frame.

    Raises:
        NotMade: An input is missing or was made with other settings.
    """
    if "raw" in stage.reads:
        workspace.mark_raw(segment)
    _check_inputs(workspace, stage, segment)
    path = workspace.shard(stage.name, segment)
    footer = read_footer(path)
    if footer is not None and state(workspace, stage, segment, settings)[0] == "fresh":
        return Made(stage.name, segment, True, footer.rows, footer.counts, 0.0, 0.0)
    started = time.perf_counter()
    inputs = Inputs(workspace, stage, segment)
    rows = write(
        path,
        stage.row,
        _checked(stage.run(inputs, settings), segment, tick),
        stamp=workspace.shard_stamp(stage, segment, settings),
        counts=inputs.counts,
    )
    # The process's peak so far: alone in its process, the stage's own. macOS counts bytes, others kibibytes.
    unit = 2**20 if sys.platform == "darwin" else 2**10
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    made = Made(
        stage.name, segment, False, rows, dict(inputs.counts), time.perf_counter() - started, peak_mib
    )
    _log(workspace, made)
    return made


def _checked(rows: Iterator[Row], segment: str, tick: Tick) -> Iterator[Row]:
    """The rows as they come, each checked to be of the segment and after the one before."""
    last = -1
    for row in rows:
        if row.segment != segment or row.frame <= last:
            raise ValueError(f"row ({row.segment}, {row.frame}) after frame {last} of {segment}")
        last = row.frame
        yield row
        tick()


def _check_inputs(workspace: Workspace, stage: Stage, segment: str) -> None:
    for name in stage.reads:
        if name == "raw":
            continue
        condition, reason = state(workspace, BY_NAME[name], segment)
        if condition != "fresh":
            raise NotMade(
                f"{stage.name} needs {workspace.shard(name, segment)}, which is {condition} ({reason}); "
                f"run: upvl {name}, or: make {stage.name}"
            )


def _log(workspace: Workspace, made: Made) -> None:
    """Keep how long a shard took, outside the shard: no clock in files that must be the same twice."""
    line = json.dumps(
        {
            "stage": made.stage,
            "segment": made.segment,
            "rows": made.rows,
            "seconds": round(made.seconds, 3),
            "peak_mib": round(made.peak_mib),
        }
    )
    try:
        with (workspace.out / "runs.jsonl").open("a", encoding="utf-8") as file:
            file.write(line + "\n")
    except OSError as error:
        raise UpvlError(f"cannot write {workspace.out / 'runs.jsonl'}: {error.strerror}") from error


def run_all(
    workspace: Workspace,
    stages: Sequence[Stage],
    segments: Sequence[str],
    *,
    overrides: Mapping[str, Any],
    workers: int,
    tick: Tick,
) -> Iterator[Made]:
    """Run stages, in order, on each segment; yields as shards are made.

    Args:
        workspace: Where.
        stages: What to run, each after those it reads.
        segments: Which drives.
        overrides: Values of the command line, for a single stage.
        workers: Processes to run segments in; 1 stays in this one.
        tick: Called after each frame, in this process only.
    """
    settings = {stage.name: claim_folder(workspace, stage, overrides) for stage in stages}
    if workers == 1 or len(segments) == 1:
        for segment in segments:
            for stage in stages:
                yield make_shard(workspace, stage, segment, settings[stage.name], tick)
        return
    names = [stage.name for stage in stages]
    job = partial(_run_segment, workspace.stages, workspace.out, names, settings, max(1, threads() // workers))
    # Spawned, not forked: threads of numerical libraries do not survive a fork.
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _quiet_worker) as pool:
        try:
            for done in as_completed([pool.submit(job, segment) for segment in segments]):
                yield from done.result()
        except BrokenProcessPool as error:
            raise UpvlError(
                "a worker process was killed, perhaps for want of memory; what was finished is kept: run again "
                "with fewer --workers"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _quiet_worker() -> None:
    """Let the parent alone answer Ctrl-C, and clean up when it sends the end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _run_segment(
    stages: Path, out: Path, names: list[str], settings: dict[str, Any], cores: int, segment: str
) -> list[Made]:
    os.environ[THREADS_VARIABLE] = str(cores)
    workspace = Workspace(stages, out)
    return [make_shard(workspace, BY_NAME[name], segment, settings[name], _no_tick) for name in names]


def _no_tick() -> None:
    """The progress of a worker process is counted by shards, in the parent."""
