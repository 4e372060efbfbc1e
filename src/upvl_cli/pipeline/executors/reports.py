"""What a task of a queue is at: a file of lines that the task appends to, and that whoever submitted it follows."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import IO

from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.executors.base import Executor, Failed, Started, Warned, Watch, Work
from upvl_cli.pipeline.runner import Made

REPORTS_VARIABLE = "UPVL_TASK_REPORTS"  # path of the file, in the environment of a task
_FRAMES_S = 5.0  # frames are reported that often: the file may lie on a file system that many machines share

Event = Started | Warned | Made | Failed | int  # an int counts frames that are done


class ReportingExecutor:
    """Another executor, whose shards are also reported in a file."""

    def __init__(self, executor: Executor, path: Path) -> None:
        """Take the executor that makes the shards, and the file of the reports."""
        self._executor = executor
        self._path = path

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`, and report each that is begun, made or given up."""
        with self._path.open("a", encoding="utf-8") as file:
            reports = _Reports(file, watch)
            for event in self._executor.run(work, reports):
                reports.write(event)
                yield event


def reporting(executor: Executor) -> Executor:
    """Return an executor that reports to whoever submitted this task; the same one where nobody did."""
    path = os.environ.get(REPORTS_VARIABLE)
    return ReportingExecutor(executor, Path(path)) if path else executor


class _Reports:
    """A `Watch` that writes what it sees, and passes it on."""

    def __init__(self, file: IO[str], watch: Watch) -> None:
        self._file, self._watch = file, watch
        self._lock = threading.Lock()  # frames may be counted by any thread
        self._frames = 0
        self._written_s = time.monotonic()

    def tick(self, frames: int = 1) -> None:
        """Count frames that are done."""
        self._watch.tick(frames)
        with self._lock:
            self._frames += frames
            if time.monotonic() - self._written_s < _FRAMES_S:
                return
        self.write(0)

    def started(self, started: Started) -> None:
        """Report what has begun."""
        self._watch.started(started)
        self.write(started)

    def warned(self, warned: Warned) -> None:
        """Report what is suspicious in a drive."""
        self._watch.warned(warned)
        self.write(warned)

    def failed(self, failed: Failed) -> None:
        """Pass it on: the executor yields it too."""
        self._watch.failed(failed)

    def write(self, event: Event) -> None:
        """Append an event, and the frames that were counted before it."""
        with self._lock:
            frames, self._frames = self._frames, 0
            self._written_s = time.monotonic()
            lines: list[dict[str, object]] = [{"frames": frames}] if frames else []
            lines += [] if isinstance(event, int) else [_line_of(event)]
            self._file.write("".join(json.dumps(line) + "\n" for line in lines))
            self._file.flush()


def _line_of(event: Started | Warned | Made | Failed) -> dict[str, object]:
    if isinstance(event, Warned):
        return {"event": "warned", "segment": event.segment, "text": event.text}
    shard = {"stage": event.stage, "segment": event.segment}
    if isinstance(event, Started):
        return {"event": "started", **shard}
    if isinstance(event, Failed):
        return {"event": "failed", **shard, "message": str(event.error)}
    return {"event": "made", **asdict(event)}


class ReportReader:
    """The reports of one task, as they arrive.

    Attributes:
        at: Stage and segment of the shard that the task has begun and not finished; None between two shards.
    """

    def __init__(self, path: Path, where: str) -> None:
        """Take the file, which need not exist yet, and the name of the task for those who watch."""
        self._path, self._where = path, where
        self._read = 0
        self.at: tuple[str, str] | None = None

    def new(self) -> Iterator[Event]:
        """Yield what was reported since the last call."""
        if not self._path.is_file():
            return
        with self._path.open("rb") as file:
            file.seek(self._read)
            for line in file:
                if not line.endswith(b"\n"):
                    return  # its end is being written
                self._read += len(line)
                # A shared file system may show what another machine appends before it is all there; the stamps of the
                # shards are compared in the end.
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    event = _event_of(json.loads(line), self._where)
                    if isinstance(event, Started | Made | Failed):
                        self.at = (event.stage, event.segment) if isinstance(event, Started) else None
                    yield event


def _event_of(line: dict[str, object], where: str) -> Event:
    if "frames" in line:
        return int(str(line["frames"]))
    kind = line.pop("event")
    if kind == "made":
        return Made(**line)  # type: ignore[arg-type]
    if kind == "warned":
        return Warned(str(line["segment"]), str(line["text"]))
    stage, segment = str(line["stage"]), str(line["segment"])
    if kind == "failed":
        return Failed(stage, segment, UpvlError(str(line["message"])))
    return Started(stage, segment, where)
