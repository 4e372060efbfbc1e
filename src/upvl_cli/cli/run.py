"""Run stages of a workspace, with their progress on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.workspace import Workspace


def run_stages(
    workspace: Workspace,
    stages: Sequence[AnyStage],
    segments: Sequence[str] | None,
    *,
    workers: int,
    overrides: Mapping[str, object],
) -> None:
    """Make the shards of stages: a live display on a terminal, one line a shard elsewhere."""
    from upvl_cli.cli.progress import Progress
    from upvl_cli.pipeline.runner import run_all

    chosen = segments or list(workspace.segments)
    for name in chosen:
        workspace.check_name(name, workspace.segments)
    with Progress(sum(1 if stage.is_of_dataset else len(chosen) for stage in stages)) as progress:
        for made in run_all(
            workspace, stages, chosen, overrides=overrides, workers=workers, tick=progress.tick
        ):
            progress.done(made)
