"""Makes a new workspace: the settings of every stage, and a Makefile."""

from __future__ import annotations

import shutil
from pathlib import Path

from upvl_cli.errors import BadSetting, UpvlError


def create(folder: Path) -> None:
    """Write `stages/*.toml` and a Makefile into a folder.

    Args:
        folder: The new workspace; it may exist, but must not hold settings already.

    Raises:
        BadSetting: It is a workspace already.
        UpvlError: It cannot be written.
    """
    taken = [path for path in (folder / "stages", folder / "Makefile") if path.exists()]
    if taken:
        raise BadSetting(f"{taken[0]} exists already: choose another folder, nothing was changed")
    source = _source()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / "workspace.mk", folder / "Makefile")
        shutil.copytree(source / "stages", folder / "stages")
    except OSError as error:
        raise UpvlError(f"cannot write {error.filename}: {error.strerror}") from error


def _source() -> Path:
    """Where the settings are: inside an installed package, or at the root of a checkout."""
    package = Path(__file__).parent
    installed = package / "workspace"
    return installed if installed.is_dir() else package.parents[1]
