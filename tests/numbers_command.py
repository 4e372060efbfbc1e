"""What a queue runs in its tests: make the shards of numbered drives, those of one share or all of them.

python -m numbers_command FOLDER [--shard I/N]

A file raw/starts in the folder holds a digit for each start: at 1 the process is killed at once, at 2 when it is done.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from toy_pipeline import STAGES, open_numbers
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.executors.share import Share


def main() -> int:
    """Make them in this process; the exit codes are those of `upvl`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shard", default="1/1")
    given = parser.parse_args()
    digit = take_start(given.folder / "raw" / "starts")
    if digit == "1":
        os.kill(os.getpid(), signal.SIGKILL)
    workspace = open_numbers(given.folder)
    segments = Share.parse(given.shard).of(workspace.segments)
    try:
        for _ in run_all(workspace, STAGES, segments, overrides={}):
            pass
    except UpvlError as error:
        print(f"upvl: {error}", file=sys.stderr)
        return 2
    if digit == "2":
        os.kill(os.getpid(), signal.SIGKILL)
    return 0


def take_start(path: Path) -> str:
    """Return the first digit of a file, and take it away; nothing where there is none."""
    digits = path.read_text() if path.is_file() else ""
    if digits:
        path.write_text(digits[1:])
    return digits[:1]


if __name__ == "__main__":
    sys.exit(main())
