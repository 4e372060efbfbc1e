"""Runs `upvl` whole, as a person would, in a workspace of the test's own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# A detector that learns nothing, but at once.
TINY_TRAINING = {
    "steps": "2",
    "check_steps": "2",
    "width": "8",
    "pillar_m": "0.8",
    "paste": "1",
    "batch": "1",
}
UPVL = Path(sys.executable).with_name("upvl")


def make_workspace(folder: Path, **values: str) -> Path:
    """A workspace with the settings that ship, on the quickest drive, but for `stage__key="value as TOML"`."""
    shutil.copytree(ROOT / "stages", folder / "stages")
    set_value(folder, "raw", "dataset", '"street"')
    # Motion alone, as most tests have it: no network to load.
    for preset in sorted((folder / "stages" / "presets" / "moving-only").glob("*.toml")):
        for line in preset.read_text().splitlines():
            if not line.startswith("#"):
                key, _, value = line.partition(" = ")
                set_value(folder, preset.stem, key, value)
        preset.unlink()  # so that a value of the test's own counts
    for key, value in TINY_TRAINING.items():
        set_value(folder, "train", key, value)
    for name, value in values.items():
        stage, key = name.split("__")
        set_value(folder, stage, key, value)
    return folder


def set_value(workspace: Path, stage: str, key: str, value: str) -> None:
    """Change one value of a workspace."""
    path = workspace / "stages" / f"{stage}.toml"
    lines = path.read_text().splitlines()
    assert any(line.startswith(f"{key} =") for line in lines), f"{path} has no {key}"
    path.write_text(
        "\n".join(f"{key} = {value}" if line.startswith(f"{key} =") else line for line in lines) + "\n"
    )


# Whatever the caller's environment holds; the street of the tests is found through the second path.
ENVIRONMENT = {"PATH": "/usr/bin:/bin", "COLUMNS": "120", "PYTHONPATH": str(ROOT / "tests")}


def upvl(workspace: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run one command in a workspace and wait for its end."""
    return subprocess.run(
        [UPVL, *arguments], cwd=workspace, capture_output=True, text=True, timeout=300,
        env={**ENVIRONMENT, **environment},
    )  # fmt: skip


def fails(workspace: Path, *arguments: str) -> str:
    """The one line on standard error of a command that a user can mend: exit code 2."""
    done = upvl(workspace, *arguments)
    assert done.returncode == 2, f"exit {done.returncode}: {done.stdout}{done.stderr}"
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("upvl: ")
    return lines[0]
