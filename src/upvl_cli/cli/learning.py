"""Commands about the detector, beside its stages."""

from __future__ import annotations

import typer

from upvl_cli.cli.application import app
from upvl_cli.stages import BY_NAME
from upvl_cli.workspace import WHOLE, Workspace


@app.command()
def curves(context: typer.Context) -> None:
    """Draw how the losses of the last training fell."""
    from upvl_cli.detector.checkpoint import LOSSES
    from upvl_cli.detector.curves import draw
    from upvl_cli.tables import Table

    workspace: Workspace = context.obj
    (row,) = Table(workspace.shard("train", WHOLE), BY_NAME["train"].row)
    path = workspace.out / "train" / "curves.png"
    draw(path, {name: getattr(row, name) for name in LOSSES}, row.rate, row.check_step, row.check_total)
    print(path)
