"""Runs presets, each a few values that differ from those that ship, and makes no shard twice."""

from __future__ import annotations

import json
import os
import shutil
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.runner import Made, Tick, claim_folder, make_shard
from upvl_cli.settings import load
from upvl_cli.stages import BY_NAME, STAGES
from upvl_cli.workspace import Workspace, write_if_changed


def preset_workspace(base: Workspace, name: str) -> Workspace:
    """The workspace of a preset, `out/tables/<name>`, with all its values written out.

    Args:
        base: The workspace that it differs from.
        name: A folder of `stages/presets`.

    Raises:
        BadSetting: There is no such preset, or it holds a file or a value that no stage knows.
    """
    folder = base.stages / "presets" / name
    if not folder.is_dir():
        raise BadSetting(
            f"{folder} is missing; a preset is a folder with the values that differ, a TOML file a stage"
        )
    unknown = [
        path.name for path in sorted(folder.iterdir()) if path.suffix != ".toml" or path.stem not in BY_NAME
    ]
    if unknown:
        raise BadSetting(
            f"{folder} holds {', '.join(unknown)}; expected files of stages: {', '.join(BY_NAME)}"
        )
    workspace = Workspace(base.out / "tables" / name / "stages", base.out / "tables" / name)
    _write_values(workspace.stages / "raw.toml", asdict(base.raw))
    for stage in STAGES:
        path = folder / f"{stage.name}.toml"
        try:
            settings = load(stage.params, base.stages / f"{stage.name}.toml", _differing(path))
        except BadSetting as error:
            raise BadSetting(f"preset {name}: {error}") from None
        _write_values(workspace.stages / f"{stage.name}.toml", asdict(settings))
    return workspace


def make(
    base: Workspace, workspace: Workspace, others: Sequence[Workspace], segment: str, tick: Tick
) -> Iterator[Made]:
    """Make all shards of a segment; one that another workspace makes from equal values is made there and linked.

    Args:
        base: The workspace that all presets differ from; the first to lend a shard with an equal stamp.
        workspace: Where to make them.
        others: Presets that have been made; the next to lend one.
        segment: Which drive.
        tick: Called after each frame.

    Raises:
        UpvlError: A shard cannot be made or written.
    """
    _link(base.mark_raw(segment), workspace.shard("raw", segment))
    for stage in STAGES:
        stamp = workspace.shard_stamp(stage, segment)
        owner = next(
            (other for other in (base, *others) if other.shard_stamp(stage, segment) == stamp), workspace
        )
        settings = claim_folder(owner, stage, {})
        yield make_shard(owner, stage, segment, settings, tick)
        if owner is not workspace:
            claim_folder(workspace, stage, {})
            _link(owner.shard(stage.name, segment), workspace.shard(stage.name, segment))


def _differing(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadSetting(f"{path} is not valid TOML: {error}") from None


def _write_values(path: Path, values: dict[str, Any]) -> None:
    # Numbers, texts, truths and lists of them are written in TOML as in JSON.
    write_if_changed(
        path, "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())
    )


def _link(source: Path, target: Path) -> None:
    """The same file under a second name, or a copy of the same age where the disk knows no second names."""
    if target.exists() and target.samefile(source):
        return
    part = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        part.unlink(missing_ok=True)
        try:
            os.link(source, part)
        except OSError:
            shutil.copy2(source, part)
        part.replace(target)
    except OSError as error:
        raise UpvlError(
            f"cannot write {target}: {error.strerror}; make room or make the folder writable"
        ) from error
