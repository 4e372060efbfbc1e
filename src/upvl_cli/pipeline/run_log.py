"""The run log: what making each shard took, kept outside of the shards, because shards hold no clock.

In a local folder every process appends its lines to `runs.jsonl`. An object of an object store cannot be appended to:
there each process collects its lines and puts them as a new object into `runs/`, now and then and when it ends.
Nothing depends on the log but tables of costs: it can be removed at any time, and a failure to write it is a warning.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import math
import os
import re
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from upvl_cli.errors import UpvlError, one_line
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.runtime.atomic import atomic_file

FILE = "runs.jsonl"
FOLDER = "runs"
# Lines of a killed process that are not yet in the object store are lost: at most those of a minute at first. The
# interval doubles up to ten minutes, so that a long job leaves few objects to list and read.
FIRST_PART_S = 60.0
LONGEST_PART_S = 600.0
_READERS = 64  # requests at a time: reading small objects is waiting
_BLOCK_BYTES = 2**24


@dataclass(frozen=True, slots=True)  # slots: an archive has millions
class RunRecord:
    """What making one shard took.

    Attributes:
        stage: Name of the stage.
        segment: Name of the drive; `WHOLE_DATASET` for a stage that is made once.
        rows: Number of frames that have a row.
        seconds: Elapsed time.
        cpu_s: Processor time, user and system, of the process and of those that it started and waited for; None where
            the log does not hold it.
        gpu_s: Elapsed time in which the process held a GPU; 0 without one.
        peak_mib: Largest resident memory that the process had reached by then, stages before it in the same process
            included; None where the log does not hold it.
        size_bytes: Size of the shard; None where the log does not hold it.
        read_bytes: Size of the shards that were its inputs; 0 where it is not known.
        host: Name of the machine.
        end: Time when it was finished, in seconds since 1970; 0 where it is not known.
        settings: Digest of the settings and versions that made it (`settings_digest`); empty where it is not known.
    """

    stage: str
    segment: str
    rows: int
    seconds: float
    cpu_s: float | None = None
    gpu_s: float = 0.0
    peak_mib: float | None = None
    size_bytes: int | None = None
    read_bytes: int = 0
    host: str = ""
    end: float = 0.0
    settings: str = ""


def settings_digest(stage_stamp: str) -> str:
    """Return a short digest of what makes the shards of a stage beside the drives."""
    return hashlib.sha256(stage_stamp.encode()).hexdigest()[:12]


def host_name() -> str:
    """Return the short name of this machine, in characters that any file name may have."""
    return re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname().partition(".")[0])[:40] or "host"


def log_run(out: Path, record: RunRecord) -> None:
    """Keep what a shard took; a failure is a warning on standard error.

    Args:
        out: Folder of the shards.
        record: What making one of them took.
    """
    line = json.dumps({name: _rounded(value) for name, value in asdict(record).items() if value is not None})
    if is_remote(out):
        _parts_of(out).add(line)
        return
    try:
        _append(out / FILE, line)
    except OSError as error:
        _warn(out / FILE, error)


def flush_runs() -> None:
    """Put the lines that this process has collected for object stores; call it when a job ends."""
    for parts in list(_collected.values()):
        parts.put()


def read_runs(out: Path) -> Iterator[RunRecord]:
    """Yield the records of a run log, each file in its order; lines that a kill cut short are left out.

    Args:
        out: Folder of the shards.
    """
    for block in run_blocks(out):
        yield from records_of(block)


def run_blocks(out: Path) -> Iterator[bytes]:
    """Yield the lines of a run log in blocks of many, each file in its order."""
    if not is_remote(out):
        with contextlib.suppress(OSError), (out / FILE).open("rb") as file:
            yield from _blocks_of(file)
    with contextlib.suppress(OSError, UpvlError):
        paths = sorted((out / FOLDER).glob("*.jsonl"))
        with ThreadPoolExecutor(_READERS) as pool:
            for start in range(0, len(paths), _READERS):
                yield b"\n".join(pool.map(_bytes_of, paths[start : start + _READERS]))


def records_of(block: bytes) -> Iterator[RunRecord]:
    """Yield the records of some lines; what is no record is left out."""
    for line in block.decode("utf-8", "replace").split("\n"):
        with contextlib.suppress(
            ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError
        ):
            yield _record(json.loads(line))


def last_runs(out: Path) -> dict[tuple[str, str], RunRecord]:
    """Return the last record of each stage and segment.

    Args:
        out: Folder of the shards.
    """
    runs: dict[tuple[str, str], RunRecord] = {}
    for record in read_runs(out):
        key = record.stage, record.segment
        if key not in runs or record.end >= runs[key].end:
            runs[key] = record
    return runs


class _Parts:
    """The lines of this process for one object store, put as new objects."""

    def __init__(self, out: Path) -> None:
        self._folder = out / FOLDER
        # Random, not of the clock: two containers can have the same host name and process number.
        self._name = f"{host_name()}-{os.getpid()}-{secrets.token_hex(4)}"
        self._lock = threading.Lock()
        self._lines: list[str] = []
        self._timer: threading.Timer | None = None
        self._interval_s = FIRST_PART_S
        self._number = 0

    def add(self, line: str) -> None:
        """Keep a line, and have it put in a while."""
        with self._lock:
            self._lines.append(line)
            if self._timer is None:
                self._timer = threading.Timer(self._interval_s, self.put)
                self._timer.daemon = True
                self._timer.start()
                self._interval_s = min(2 * self._interval_s, LONGEST_PART_S)

    def put(self) -> None:
        """Put what has been collected; what cannot be put is dropped with a warning."""
        with self._lock:
            lines, self._lines = self._lines, []
            path = self._folder / f"{self._name}-{self._number}.jsonl"
            self._number += bool(lines)
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
        if not lines:
            return
        try:
            with atomic_file(path) as file:
                file.write("".join(f"{line}\n" for line in lines).encode())
        except (OSError, UpvlError) as error:
            _warn(path, error)


_collected: dict[tuple[int, Path], _Parts] = {}


def _parts_of(out: Path) -> _Parts:
    """Return the collected lines of this process: a forked child begins with none of its parent's."""
    key = os.getpid(), out
    if key not in _collected:
        if not any(process == key[0] for process, _ in _collected):
            _collected.clear()
            atexit.register(flush_runs)
        _collected[key] = _Parts(out)
    return _collected[key]


def _append(path: Path, line: str) -> None:
    """Append a line by one write: several processes append at once, and none tears the line of another."""
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        size = os.fstat(descriptor).st_size
        # What a full disk or a kill cut short has no end: begin a line of its own.
        is_cut = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
        os.write(descriptor, ("\n" * is_cut + line + "\n").encode())
    finally:
        os.close(descriptor)


def _blocks_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield a file in blocks that end where a line does."""
    rest = b""
    while read := file.read(_BLOCK_BYTES):
        block, newline, rest = (rest + read).rpartition(b"\n")
        if newline:
            yield block
    if rest:
        yield rest


def _bytes_of(path: Path) -> bytes:
    with contextlib.suppress(OSError, UpvlError):
        return path.read_bytes()
    return b""


def _record(run: dict[str, Any]) -> RunRecord:
    """Return a line of the log as a record; lines of older versions have fewer values."""
    size_bytes = run.get("size_bytes")
    return RunRecord(
        stage=str(run["stage"]),
        segment=str(run["segment"]),
        rows=int(run.get("rows", 0)),
        seconds=_finite(run["seconds"]),
        cpu_s=_finite_or_none(run.get("cpu_s")),
        gpu_s=_finite(run.get("gpu_s", 0.0)),
        peak_mib=_finite_or_none(run.get("peak_mib")),
        size_bytes=None if size_bytes is None else int(size_bytes),
        read_bytes=int(run.get("read_bytes", 0)),
        host=str(run.get("host", "")),
        end=_finite(run.get("end", 0.0)),
        settings=str(run.get("settings", "")),
    )


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(value)
    return number


def _finite_or_none(value: Any) -> float | None:
    return None if value is None else _finite(value)


def _rounded(value: object) -> object:
    return round(value, 3) if isinstance(value, float) else value


def _warn(path: Path, error: BaseException) -> None:
    reason = (isinstance(error, OSError) and error.strerror) or one_line(error)
    sys.stderr.write(f"upvl: warning: cannot write {path}: {reason}; the cost of this run is not kept\n")
