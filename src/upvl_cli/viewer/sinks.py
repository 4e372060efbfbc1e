"""Where a recording goes: into a file, to the viewer's window, or to a browser on this machine alone."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.runtime.atomic import atomic_path
from upvl_cli.viewer.library import SinkLost, flush, rerun_library

APPLICATION = "upvl"
HOST = "127.0.0.1"  # the library itself would listen to the whole network
WEB_PORT, DATA_PORT = 9090, 9876  # those of Rerun
# A file of Rerun that was written to its end has this within its last bytes.
_FOOTER, _FOOTER_BYTES = b"RRF2FOOT", 64
# The viewer sends anonymous statistics of its use to its makers, but where it runs in continuous integration. What is
# looked at here is nobody else's business.
_NO_STATISTICS = {"CI": "1"}
# Frames in one chunk of a file: fewer chunks to list at its end, and some 15 % fewer bytes.
_LARGE_CHUNKS = MappingProxyType({"flush_tick": timedelta(seconds=10), "flush_num_bytes": 4 * 2**20})
_START_S = 30.0
_MEMORY = "50%"  # of this machine, from where on the viewer drops its oldest frames


@contextlib.contextmanager
def saved_recording(path: Path) -> Iterator[Any]:
    """Give a recording that becomes a file when the block ends well.

    Args:
        path: The file; its folder is made.

    Raises:
        BadSetting: The name is not that of a recording.
        UpvlError: The folder cannot be written or the disk is full.
    """
    recording = new_recording(_LARGE_CHUNKS)
    if path.suffix != ".rrd":
        raise BadSetting(
            f"{path} does not end in .rrd, by which the viewer knows its files; name it {path.stem or 'drive'}.rrd"
        )
    with atomic_path(path) as part:
        recording.save(part)
        not_written = f"{path} could not be written to its end; make room on its disk, or show fewer frames"
        try:
            yield recording
        except SinkLost as error:
            raise UpvlError(not_written) from error
        recording.disconnect()  # writes what is left, and the footer
        # The library writes in a thread of its own, which does not tell of every failure.
        if not _ends_with_footer(part):
            raise UpvlError(not_written)


def _ends_with_footer(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(-min(file.tell(), _FOOTER_BYTES), os.SEEK_END)
        return _FOOTER in file.read()


def has_display() -> bool:
    """Return whether windows can be opened; on Linux a variable of the desktop tells."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def new_recording(chunks: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Return a recording without a sink; it has the time lines that are set, and no others.

    Args:
        chunks: How much is put into a chunk before it goes out, as of `rerun.ChunkBatcherConfig`; without that what is
            logged goes out at once.
    """
    rr = rerun_library()
    recording = rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(**chunks))
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)
    return recording


@contextlib.contextmanager
def window_recording() -> Iterator[Any]:
    """Give a recording that the viewer's window shows; the window stays when the block ends.

    Raises:
        BadSetting: The viewer does not start.
    """
    recording = new_recording()
    port = _free_port(DATA_PORT)
    _start("--port", str(port), "--expect-data-soon", "--hide-welcome-screen", data_port=port)
    recording.connect_grpc(_data_address(port))
    yield recording
    flush(recording)
    recording.disconnect()


@dataclass(frozen=True)
class WebViewer:
    """A viewer in the browser: the address of its page, the recording that it shows, and its process."""

    address: str
    recording: Any
    process: subprocess.Popen[bytes]

    def wait(self) -> None:
        """Wait until the viewer is stopped."""
        flush(self.recording)
        self.process.wait()


@contextlib.contextmanager
def web_viewer() -> Iterator[WebViewer]:
    """Give a viewer for a browser on this machine, which ends with the block.

    Raises:
        BadSetting: The viewer does not start.
    """
    recording = new_recording()
    page, data = _free_port(WEB_PORT), _free_port(DATA_PORT)
    process = _start(
        "--serve-web", "--port", str(data), "--web-viewer-port", str(page), data_port=data
    )  # fmt: skip
    try:
        recording.connect_grpc(_data_address(data))
        yield WebViewer(
            f"http://{HOST}:{page}/?url={quote(_data_address(data), safe='')}", recording, process
        )
    finally:
        recording.disconnect()
        _end(process)


def _data_address(port: int) -> str:
    return f"rerun+http://{HOST}:{port}/proxy"


def _start(*arguments: str, data_port: int) -> subprocess.Popen[bytes]:
    """Start the viewer that ships with the library and wait until it listens, to this machine alone."""
    process = subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", "--bind", HOST, "--server-memory-limit", _MEMORY, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **_NO_STATISTICS},
        start_new_session=True,  # Ctrl-C is for us, and we end it
    )
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s:
        if process.poll() is not None:
            break
        with contextlib.suppress(OSError), socket.create_connection((HOST, data_port), timeout=1):
            return process
        time.sleep(0.05)
    _end(process)
    raise BadSetting(
        "the viewer of rerun does not start; see why: python -m rerun; or show the drive in a browser: --web, or "
        "save it: --save drive.rrd"
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the viewer: the process that we started, and the one that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    process.wait()


def _free_port(preferred: int) -> int:
    """Return the usual port where it is free, else any free one."""
    for port in (preferred, 0):
        with contextlib.suppress(OSError), socket.socket() as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((HOST, port))
            return int(listener.getsockname()[1])
    raise BadSetting(f"no port is free on {HOST}; close other programs")
