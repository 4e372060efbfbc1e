"""The workspace around a folder of results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace


def open_workspace(out: Path, stages: Path) -> Workspace:
    """Return the workspace of some results.

    A relative `root` of raw.toml is seen from where upvl is run, and where it leads nowhere, from the folder that the
    settings stand in: a notebook runs elsewhere.

    Args:
        out: Folder of the results.
        stages: Folder of the settings.

    Raises:
        BadSetting: There are no settings.
    """
    if not (stages / "raw.toml").is_file():
        raise BadSetting(
            f"{stages} has no raw.toml; queries, points and recordings need the settings of the workspace: "
            'upvl.open("out", stages="FOLDER")'
        )
    workspace = Workspace(PIPELINE, stages, out)
    root = Path(workspace.raw.root).expanduser()
    beside = stages.parent / root
    if not root.is_absolute() and not root.exists() and beside.exists():
        workspace.raw = replace(workspace.raw, root=str(beside))
    return workspace
