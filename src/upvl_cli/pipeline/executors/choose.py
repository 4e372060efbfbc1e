"""The executor that the command line names."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Sequence

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.executors.base import Executor
from upvl_cli.pipeline.executors.job_array import QueueCommand
from upvl_cli.pipeline.executors.processes import ProcessExecutor
from upvl_cli.pipeline.executors.serial import SerialExecutor
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions
from upvl_cli.pipeline.executors.slurm_queue import SlurmExecutor
from upvl_cli.runtime.parallel import threads

SERIAL, PROCESSES, RAY, SLURM = "serial", "processes", "ray", "slurm"
FORMS = "serial, processes:8, ray, ray://head:10001 or slurm"


def is_executor(text: str) -> bool:
    """Return whether a value of `--on` begins with the name of an executor."""
    return text.partition(":")[0] in (SERIAL, PROCESSES, RAY, SLURM)


def choose(text: str, command: Sequence[str] = (), slurm: str = "") -> Executor:
    """Return the executor that a value of `--on` names.

    Args:
        text: The value.
        command: The words after `upvl`, for a queue.
        slurm: The value of `--slurm`.

    Raises:
        BadSetting: It names none.
    """
    name, has_colon, rest = text.partition(":")
    if name == SERIAL and not has_colon:
        return SerialExecutor()
    if name == PROCESSES:
        return ProcessExecutor(_workers(text, rest) if has_colon else threads())
    if name == RAY:
        from upvl_cli.pipeline.executors.ray_cluster import RayExecutor

        return RayExecutor(_address(text, has_colon, rest))
    if name == SLURM:
        return SlurmExecutor(queue_command(text, command, slurm))
    close = difflib.get_close_matches(name, (SERIAL, PROCESSES, RAY, SLURM), n=1)
    hint = f"; did you mean {close[0]}?" if close and close[0] != text else ""
    raise BadSetting(f"--on {text!r}: expected {FORMS}{hint}")


def _address(text: str, has_colon: str, rest: str) -> str | None:
    host, _, port = rest.removeprefix("//").rpartition(":")
    if not has_colon:
        return None
    if not (rest.startswith("//") and host and port.isascii() and port.isdigit()):
        raise BadSetting(f"--on {text!r}: expected ray, or the address of a cluster such as ray://head:10001")
    return text


def queue_command(text: str, command: Sequence[str], slurm: str) -> QueueCommand:
    """Return the command that a queue runs in shares.

    Raises:
        BadSetting: The value of `--on` or `--slurm` is none.
    """
    if text not in (SLURM, f"{SLURM}:local"):
        raise BadSetting(f"--on {text!r}: expected slurm, or slurm:local to run the array on this machine")
    words = without_place(command)
    return QueueCommand(
        (sys.executable, "-m", "upvl_cli"), words, SlurmOptions.parse(slurm), is_local=text != SLURM
    )


def without_place(command: Sequence[str]) -> tuple[str, ...]:
    """Return the words of a command without those that say where it runs."""
    kept: list[str] = []
    words = iter(command)
    for word in words:
        name, has_value, value = word.partition("=")
        if name == "--dry-run":
            continue
        if name in ("--on", "--slurm"):
            value = value if has_value else next(words, "")
            if name == "--slurm" or is_executor(value):
                continue
            kept += [name, value]
        else:
            kept.append(word)
    return tuple(kept)


def _workers(text: str, number: str) -> int:
    if not (number.isascii() and number.isdigit() and len(number) < 5 and int(number) > 0):
        raise BadSetting(f"--on {text!r}: expected a number of processes from 1 to 9999, such as processes:8")
    return int(number)
