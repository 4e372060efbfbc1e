"""What a task of a SLURM array does: run one `upvl` command, and leave its exit code in a file."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from upvl_cli.pipeline.executors.reports import REPORTS_VARIABLE
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.runtime.parallel import THREADS_VARIABLE

_SHOWN_CHARACTERS = 2000


def run_command(command: list[str], folder: str, cores: str, result: str, reports: str) -> None:
    """Run a command, and write how it ended.

    Takes texts alone, because submitit keeps its arguments in a file and reads them again.

    Args:
        command: Its words.
        folder: Where to run it.
        cores: Threads that a stage may use.
        result: Path of the file of the exit code and of the last line that it wrote to standard error.
        reports: Path of the file of what it is at.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    environment = {**os.environ, THREADS_VARIABLE: cores, REPORTS_VARIABLE: reports}
    with subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            _, errors = process.communicate()
        except BaseException:
            process.terminate()
            raise
    sys.stderr.write(errors)
    last = (errors.strip().splitlines() or [""])[-1][:_SHOWN_CHARACTERS]
    if process.returncode >= 0:  # one that was killed leaves no file, and is run again
        with atomic_file(Path(result)) as file:
            file.write(json.dumps({"code": process.returncode, "message": last}).encode())
