"""Workspaces for the benchmarks: the settings that ship, on drives that the caller names."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def on_kitti(folder: Path, root: Path, segments: list[str]) -> Path:
    """Make a workspace in `folder` for KITTI drives under `root`; see `on_drives`."""
    return on_drives(folder, "kitti", root, segments)


def on_drives(folder: Path, dataset: str, root: Path, segments: list[str]) -> Path:
    """Make a workspace in `folder` for drives of any dataset under `root`; an empty list takes all of them.

    Args:
        folder: Where to make it; an older one there gets the settings of today.
        dataset: Name of the dataset, as in `stages/raw.toml`.
        root: Folder of the drives.
        segments: Names of the drives.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder / "stages", ignore_errors=True)
    shutil.copytree(ROOT / "stages", folder / "stages")
    (folder / "stages" / "raw.toml").write_text(
        f"dataset = {json.dumps(dataset)}\nroot = {json.dumps(str(root.resolve()))}\n"
        f"segments = {json.dumps(segments)}\n"
    )
    return folder


def on_city(folder: Path, **values: int | str) -> Path:
    """Make a workspace in `folder` for drives of the built-in city, with some values of `synthetic.toml` changed."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder / "stages", ignore_errors=True)
    shutil.copytree(ROOT / "stages", folder / "stages")
    path = folder / "stages" / "synthetic.toml"
    text = path.read_text()
    for key, value in values.items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    path.write_text(text)
    return folder


def make(folder: Path, *stages: str) -> None:
    """Run stages in a workspace, in order."""
    for stage in stages:
        subprocess.run([Path(sys.executable).with_name("upvl"), stage], cwd=folder, check=True)
