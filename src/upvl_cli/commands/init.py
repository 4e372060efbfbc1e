"""Makes a new workspace: the settings of every stage, and a Makefile."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from upvl_cli.errors import BadSetting, UpvlError, one_line


def create(folder: Path) -> None:
    """Write `stages/*.toml` and a Makefile into a folder.

    Args:
        folder: The new workspace; it may exist, but must not hold settings already.

    Raises:
        BadSetting: It is a workspace already.
        UpvlError: It cannot be written.
    """
    source = _source()
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


def _source() -> Path:
    """Where the settings are: inside an installed package, or at the root of a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "workspace"
    return installed if installed.is_dir() else package.parents[1]
