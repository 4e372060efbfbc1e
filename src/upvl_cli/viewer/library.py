"""The package rerun, which is an extra."""

from __future__ import annotations

import os
from typing import Any

from upvl_cli.errors import BadSetting, UpvlError, one_line


def rerun_library() -> Any:
    """Return the module `rerun`.

    Raises:
        BadSetting: It is not installed.
    """
    # Its failures reach us as exceptions; what it would write of them beside is a second message.
    os.environ.setdefault("RUST_LOG", "off")
    try:
        import rerun
    except ImportError as error:
        raise BadSetting("the viewer needs the package rerun; run: pip install 'upvl[view]'") from error
    return rerun


class SinkLost(UpvlError):
    """What a recording goes to does not take it any more."""


def flush(recording: Any) -> None:
    """Wait until all that was logged has been taken by the viewer or the file.

    Args:
        recording: A `rerun.RecordingStream` with a sink.

    Raises:
        SinkLost: The viewer was closed, or the disk is full.
    """
    try:
        recording.flush()
    except RuntimeError as error:
        raise SinkLost(f"the viewer was closed before all frames were there ({one_line(error)})") from error
