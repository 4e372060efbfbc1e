"""One writer at a time for an object: a lease in place of the lock that a file system has.

A lease saves work and nothing else: an object appears whole in any case, and equal inputs give equal bytes. So a lease
that is taken over by mistake, after its holder was silent for too long, costs time alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
import uuid
from pathlib import Path
from types import TracebackType
from typing import Self

from upvl_cli.errors import StorageError
from upvl_cli.pipeline.storage.bucket import Bucket
from upvl_cli.pipeline.storage.faults import Conflict

# A holder renews its lease three times in this time; one that is silent for so long is taken for dead.
SILENCE_S = 30.0
_PAUSE_S = 0.25, 2.0  # between two looks at a lease that another process holds: first, longest


class Lease:
    """The right to make an object; `with Lease(...)` waits until this process has it."""

    def __init__(self, bucket: Bucket, key: str) -> None:
        """Name the object of the lease, which stands beside the object that is to be made.

        Args:
            bucket: Its bucket.
            key: Its key.
        """
        self._bucket, self._key = bucket, key
        self._owner = uuid.uuid4().hex
        self._version = ""
        self._renewals = 0
        self._ended = threading.Event()
        self._renewer = threading.Thread(target=self._renew, daemon=True)

    def __enter__(self) -> Self:
        """Wait for the lease."""
        pause_s = _PAUSE_S[0]
        seen, seen_at = "", 0.0
        while not self._try_to_take(None):
            try:
                text, version = self._bucket.read_whole(self._key)
            except FileNotFoundError:
                continue
            holder = _holder_of(text)
            if holder.get("owner") == self._owner:  # the answer to our own request was lost
                self._version = version
                break
            if version != seen:
                seen, seen_at = version, time.monotonic()
            is_silent = time.monotonic() - seen_at > SILENCE_S
            if (is_silent or _is_dead(holder)) and self._try_to_take(version):
                break
            time.sleep(pause_s)
            pause_s = min(1.5 * pause_s, _PAUSE_S[1])
        self._renewer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the lease back, unless another process has taken it over."""
        self._ended.set()
        self._renewer.join()
        if self._version:
            with contextlib.suppress(StorageError):  # it ends by itself
                self._bucket.delete(self._key)

    def _try_to_take(self, version: str | None) -> bool:
        try:
            self._version = self._bucket.put_if(self._key, self._text(), version)
        except Conflict:
            return False
        return True

    def _text(self) -> bytes:
        """Return what the lease says: another text each time, so that a renewal is another version."""
        me = {"owner": self._owner, "renewals": self._renewals, **_this_process()}
        return json.dumps(me, sort_keys=True).encode()

    def _renew(self) -> None:
        while not self._ended.wait(SILENCE_S / 3):
            self._renewals += 1
            try:
                self._version = self._bucket.put_if(self._key, self._text(), self._version)
            except Conflict:
                self._version = ""  # taken over: not ours to delete
                return
            except StorageError:
                continue


def _holder_of(text: bytes) -> dict[str, object]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _this_process() -> dict[str, object]:
    pid = os.getpid()
    return {"host": socket.gethostname(), "boot": _boot(), "pid": pid, "started": _start_of(pid)}


def _is_dead(holder: dict[str, object]) -> bool:
    """Whether the holder was a process of this machine that has ended; of other machines only silence tells."""
    pid = holder.get("pid")
    if not isinstance(pid, int) or not _boot() or holder.get("boot") != _boot():
        return False
    return holder.get("host") == socket.gethostname() and holder.get("started") != _start_of(pid)


def _boot() -> str:
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return ""


def _start_of(pid: int) -> str:
    """Return when a process began, in ticks since the machine did; "" where there is none, or it has ended."""
    with contextlib.suppress(OSError, IndexError):
        fields = (
            Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        )
        if fields[0] not in ("Z", "X"):
            return fields[19]
    return ""
