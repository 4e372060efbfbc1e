"""Commands about the detector, beside its stages."""

from __future__ import annotations

import typer

from upvl_cli.cli.application import app
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import TrainRow


@app.command()
def curves(context: typer.Context) -> None:
    """Draw the losses of the last training."""
    from upvl_cli.detector.checkpoint import LOSSES
    from upvl_cli.detector.curves import draw

    workspace: Workspace = context.obj
    (row,) = workspace.table("train", TrainRow)
    path = workspace.out / "train" / "curves.png"
    losses = {name: getattr(row, name) for name in LOSSES}
    draw(path, losses, row.learning_rate, row.check_step, row.check_total)
    print(path)
