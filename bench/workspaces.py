"""Workspaces for the benchmarks: the settings that ship, on drives that the caller names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]


def on_kitti(folder: Path, root: Path, segments: list[str]) -> Path:
    """A workspace in `folder` for KITTI raw drives under `root`; an empty list takes all of them.

    Args:
        folder: Where to make it; an older one there gets the settings of today.
        root: Folder that holds the date folders.
        segments: Names of the drives.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder / "stages", ignore_errors=True)
    shutil.copytree(ROOT / "stages", folder / "stages")
    (folder / "stages" / "raw.toml").write_text(
        f'dataset = "kitti"\nroot = {json.dumps(str(root.resolve()))}\nsegments = {json.dumps(segments)}\n'
    )
    return folder
