"""Runs `upvl` whole, as a person would, in a workspace of the test's own."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from upvl_cli.cli import run

ROOT = Path(__file__).parents[1]
# A detector that learns nothing, but at once.
TINY_TRAINING = {
    "steps": "2",
    "check_steps": "2",
    "width": "8",
    "pillar_m": "0.8",
    "pasted_objects": "1",
    "batch": "1",
}
UPVL = Path(sys.executable).with_name("upvl")
# Nothing of the caller's: a variable that chooses how BLAS sums would change last digits.
ENVIRONMENT = {"PATH": "/usr/bin:/bin", "COLUMNS": "120", "PYTHONPATH": str(ROOT / "tests")}


def make_workspace(folder: Path, **values: str) -> Path:
    """A workspace with the settings that ship, on the quickest drive, but for `stage__key="value as TOML"`."""
    shutil.copytree(ROOT / "stages", folder / "stages")
    set_value(folder, "raw", "dataset", '"street"')
    # Motion alone, as most tests have it: no network to load.
    for preset in sorted((folder / "stages" / "presets" / "moving-only").glob("*.toml")):
        for key, value in values_in(tomllib.loads(preset.read_text())):
            set_value(folder, preset.stem, key, value)
        preset.unlink()  # so that a value of the test's own counts
    for key, value in TINY_TRAINING.items():
        set_value(folder, "train", key, value)
    for name, value in values.items():
        stage, key = name.split("__")
        set_value(folder, stage, key, value)
    return folder


def of_streets(drives: int, *, frames: int) -> dict[str, str]:
    """Settings for `make_workspace`: some drives of the street, of so many frames each."""
    return {"raw__dataset": '"streets"', "raw__root": f'"{drives}x{frames}"'}


def values_in(tables: dict[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Each value of a TOML file as TOML, with its key: `travel.required` is `required` in the table `[travel]`."""
    for key, value in tables.items():
        if isinstance(value, dict):
            yield from values_in(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", json.dumps(value)


def set_value(workspace: Path, stage: str, key: str, value: str) -> None:
    """Change one value of a workspace; a key without a table stands for that of any table."""
    path = workspace / "stages" / f"{stage}.toml"
    table, _, name = key.rpartition(".")
    lines, here, found = path.read_text().splitlines(), "", False
    for number, line in enumerate(lines):
        here = line.strip("[]") if line.startswith("[") else here
        if line.startswith(f"{name} =") and table in ("", here):
            lines[number], found = f"{name} = {value}", True
    assert found, f"{path} has no {key}"
    path.write_text("\n".join(lines) + "\n")


def upvl(workspace: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run one command in a workspace and wait for its end."""
    return subprocess.run(
        [UPVL, *arguments], cwd=workspace, capture_output=True, text=True, timeout=300,
        env={**ENVIRONMENT, **environment},
    )  # fmt: skip


def fails(workspace: Path, *arguments: str) -> str:
    """The one line on standard error of a command that a user can mend: exit code 2.

    The command runs in this process: to start Python and load the package takes longer than to refuse.
    """
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.chdir(workspace), redirect_stdout(output), redirect_stderr(errors):
        code = run(arguments)
    assert code == 2, f"exit {code}: {output.getvalue()}{errors.getvalue()}"
    lines = errors.getvalue().strip().splitlines()
    assert len(lines) == 1, errors.getvalue()
    assert lines[0].startswith("upvl: ")
    return lines[0]
