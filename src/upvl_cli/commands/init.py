"""Make a new workspace: the settings of every stage, and a Makefile."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from upvl_cli.errors import BadSetting, UpvlError, one_line


def create(folder: Path) -> None:
    """Write `stages/*.toml` and a Makefile into a folder.

    Args:
        folder: Folder of the new workspace; it may exist, but must hold neither `stages` nor `Makefile`.

    Raises:
        BadSetting: The folder holds `stages` or `Makefile` already; nothing is changed.
        UpvlError: The folder cannot be written, or the installed package lacks the files.
    """
    source = shipped_workspace()
    try:
        taken = [path for path in (folder / "stages", folder / "Makefile") if os.path.lexists(path)]
        if taken:
            raise BadSetting(f"{taken[0]} exists already: choose another folder, nothing was changed")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as beside:
            shutil.copytree(source / "stages", Path(beside, "stages"))
            shutil.copy(source / "workspace.mk", Path(beside, "Makefile"))
            for name in ("stages", "Makefile"):
                Path(beside, name).rename(folder / name)
    except (shutil.Error, OSError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise UpvlError(f"cannot make a workspace in {str(folder)[:200]}: {reason[:200]}") from error


def shipped_workspace() -> Path:
    """Return the folder that holds `stages` and `workspace.mk` as they ship.

    The wheel has both in `upvl_cli/workspace` (see `force-include` in pyproject.toml); a checkout has them at its root.
    """
    package = Path(__file__).parents[1]
    installed = package / "workspace"
    return installed if installed.is_dir() else package.parents[1]
