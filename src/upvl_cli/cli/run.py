"""Run stages of a workspace, with their progress on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.workspace import Workspace

if TYPE_CHECKING:
    from upvl_cli.pipeline.executors.base import Executor, FirstCheck


@dataclass(frozen=True)
class RunOptions:
    """Which drives a command works on, and where: its options as they were given.

    Attributes:
        segments: Names of drives; none takes all of them.
        workers: The value of `--workers`.
        on: The value of `--on`; None without one.
        shard: The value of `--shard`; None without one.
        slurm: The value of `--slurm`.
        dry_run: Whether `--dry-run` was given.
    """

    segments: Sequence[str] | None
    workers: int = 1
    on: str | None = None
    shard: str | None = None
    slurm: str = ""
    dry_run: bool = False

    @property
    def prints_script(self) -> bool:
        """Whether the script of a queue is asked for, and no run."""
        return self.dry_run and self.is_queued

    @property
    def is_queued(self) -> bool:
        """Whether a queue runs the command, in shares."""
        return self.on is not None and self.on.partition(":")[0] == "slurm"

    def chosen(self, workspace: Workspace) -> list[str]:
        """Return the drives to work on; none where this share has none.

        Raises:
            BadSetting: A drive is unknown, or the share is none.
        """
        for name in self.segments or ():
            workspace.check_name(name, workspace.segments)
        names = list(dict.fromkeys(self.segments or workspace.segments))
        if self.shard is None:
            return names
        from upvl_cli.pipeline.executors.share import Share

        return Share.parse(self.shard).of(names)

    def executor(self) -> Executor:
        """Return where the shards are made.

        Raises:
            BadSetting: `--on` names no executor, or `--workers` asks for something else.
        """
        from upvl_cli.pipeline.executors.choose import choose
        from upvl_cli.pipeline.executors.processes import ProcessExecutor

        if self.slurm and not self.is_queued:
            raise BadSetting(f"--slurm {self.slurm}: goes with --on slurm")
        if self.on is None:
            return ProcessExecutor(self.workers)
        if self.workers != 1:
            raise BadSetting(
                f"--workers {self.workers} with --on {self.on}: give one of them; see: --on processes:8"
            )
        if self.shard is not None and self.is_queued:
            raise BadSetting(f"--shard {self.shard} with --on {self.on}: a queue makes shares of its own")
        return choose(self.on, sys.argv[1:], self.slurm)


def run_stages(
    workspace: Workspace,
    stages: Sequence[AnyStage],
    options: RunOptions,
    overrides: Mapping[str, object],
    check: FirstCheck | None = None,
) -> None:
    """Make the shards of stages: a live display on a terminal, one line a shard elsewhere.

    Args:
        workspace: The workspace of the shards.
        stages: The stages, each after those it reads.
        options: Which drives, and where.
        overrides: Values of the command line, for a single stage.
        check: What is asked of each drive before its first stage; None asks nothing.
    """
    from upvl_cli.cli.progress import Progress
    from upvl_cli.pipeline.executors.run import run_all

    if options.prints_script:
        print_script(workspace, stages, options)
        return
    executor = options.executor()
    chosen = options.chosen(workspace)
    if not chosen:
        print(f"--shard {options.shard}: there are fewer drives than shares, and none is left for this one")
        return
    with Progress(sum(1 if stage.is_of_dataset else len(chosen) for stage in stages)) as progress:
        for made in run_all(
            workspace,
            stages,
            chosen,
            overrides=overrides,
            executor=executor,
            watch=progress,
            check=check,
            part=(options.shard or "").replace("/", "-of-"),
        ):
            progress.done(made)


def run_window(
    workspace: Workspace, stage: AnyStage, options: RunOptions, text: str, overrides: Mapping[str, object]
) -> None:
    """Make one window of each drive, and join the windows of those of which it was the last."""
    from upvl_cli.pipeline.executors.share import Share
    from upvl_cli.pipeline.runner import claim_folder
    from upvl_cli.pipeline.windows import run_window as run

    window = Share.parse(text, "--window")
    if options.on is not None or options.workers != 1:
        raise BadSetting(f"--window {text}: one process makes a window; leave out --on and --workers")
    settings = claim_folder(workspace, stage, overrides)
    for segment in options.chosen(workspace):
        print(f"{stage.name} {segment}: {run(workspace, stage, segment, window, settings)}", flush=True)


def print_script(workspace: Workspace, stages: Sequence[AnyStage], options: RunOptions) -> None:
    """Print the script of the job array that would be submitted."""
    from upvl_cli.pipeline.executors.base import Work
    from upvl_cli.pipeline.executors.choose import queue_command
    from upvl_cli.pipeline.executors.slurm_queue import script_of

    command = queue_command(options.on or "", sys.argv[1:], options.slurm)
    print(script_of(command, Work(workspace, tuple(stages), options.chosen(workspace), {})), end="")
