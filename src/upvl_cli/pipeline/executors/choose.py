"""The executor that the command line names."""

from __future__ import annotations

import difflib

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.executors.base import Executor
from upvl_cli.pipeline.executors.processes import ProcessExecutor
from upvl_cli.pipeline.executors.serial import SerialExecutor
from upvl_cli.runtime.parallel import threads

SERIAL, PROCESSES, RAY, SLURM = "serial", "processes", "ray", "slurm"
FORMS = "serial, processes:8, ray, ray://head:10001 or slurm"


def is_executor(text: str) -> bool:
    """Return whether a value of `--on` begins with the name of an executor."""
    return text.partition(":")[0] in (SERIAL, PROCESSES, RAY, SLURM)


def choose(text: str) -> Executor:
    """Return the executor that a value of `--on` names; all but SLURM, which runs commands and no functions.

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


def _workers(text: str, number: str) -> int:
    if not (number.isascii() and number.isdigit() and len(number) < 5 and int(number) > 0):
        raise BadSetting(f"--on {text!r}: expected a number of processes from 1 to 9999, such as processes:8")
    return int(number)
