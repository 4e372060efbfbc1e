"""What a SLURM job asks for: the words of `--slurm`, and the script that `--dry-run` prints."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.pipeline import AnyStage

DEFAULT_TASKS = 64
_DAY_MIN = 24 * 60


@dataclass(frozen=True)
class SlurmOptions:
    """What `--slurm` can name; what is left out is the site's default, or follows from the stages.

    Attributes:
        partition: Name of the partition.
        account: Name of the account that is charged.
        qos: Name of the quality of service.
        time: Most minutes that one task may take.
        memory: Main memory of one task, GiB; 0 takes the largest that a stage declares.
        cpus: Cores of one task; 0 takes the largest number that a stage declares.
        gpus: GPUs of one task.
        tasks: Most tasks of the array; fewer where there are fewer drives.
    """

    partition: str = ""
    account: str = ""
    qos: str = ""
    time: int = _DAY_MIN
    memory: int = 0
    cpus: int = 0
    gpus: int = 0
    tasks: int = DEFAULT_TASKS

    @classmethod
    def parse(cls, text: str) -> SlurmOptions:
        """Return the options in a text such as `partition=gpu,time=120`.

        Raises:
            BadSetting: A word is no option, or its value is not what the option takes.
        """
        kinds = {spec.name: type(spec.default) for spec in fields(cls)}
        values: dict[str, str | int] = {}
        for word in filter(None, text.split(",")):
            name, has_value, value = (part.strip() for part in word.partition("="))
            if name not in kinds:
                close = difflib.get_close_matches(name, kinds, n=1)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise BadSetting(f"--slurm {word!r}: expected NAME=VALUE with {', '.join(kinds)}{hint}")
            is_number = value.isascii() and value.isdigit() and len(value) < 8
            if not has_value or not value or (kinds[name] is int and not is_number):
                wanted = "a whole number" if kinds[name] is int else "a name"
                raise BadSetting(f"--slurm {word!r}: expected {name}= and {wanted}")
            values[name] = int(value) if kinds[name] is int else value
        if values.get("tasks") == 0 or values.get("time") == 0:
            raise BadSetting(f"--slurm {text!r}: expected tasks and time of at least 1")
        return cls(**values)  # type: ignore[arg-type]

    def for_stages(self, stages: Sequence[AnyStage], drives: int) -> SlurmOptions:
        """Return the options with what follows from the stages and the number of drives."""
        return replace(
            self,
            memory=self.memory or round(max(stage.needs.memory_gib for stage in stages)),
            cpus=self.cpus or max(stage.needs.cpus for stage in stages),
            tasks=min(self.tasks, drives),
        )


def array_script(options: SlurmOptions, command: Sequence[str], folder: Path) -> str:
    """Return the script of a job array, for `sbatch`.

    Args:
        options: What each task asks for.
        command: The words after `upvl`, without what says where to run.
        folder: Where it is run.
    """
    lines = ["#!/bin/bash", "#SBATCH --job-name=upvl", f"#SBATCH --array=1-{options.tasks}"]
    lines += [f"#SBATCH --cpus-per-task={options.cpus}", f"#SBATCH --mem={options.memory}G"]
    lines += [f"#SBATCH --time={options.time}"]
    lines += [f"#SBATCH --gpus-per-node={options.gpus}"] if options.gpus else []
    for name in ("partition", "account", "qos"):
        value = getattr(options, name)
        lines += [f"#SBATCH --{name}={value}"] if value else []
    lines += ["#SBATCH --output=upvl-%A_%a.log", "#SBATCH --open-mode=append", ""]
    lines += [f"cd {shlex.quote(str(folder))}", "export UPVL_THREADS=$SLURM_CPUS_PER_TASK"]
    lines += [f"upvl {shlex.join(command)} --shard $SLURM_ARRAY_TASK_ID/{options.tasks}", ""]
    return "\n".join(lines)
