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

from upvl_cli.errors import BadSetting, UpvlError, one_line
from upvl_cli.runner import Made, Tick, claim_folder, make_shard
from upvl_cli.settings import load
from upvl_cli.stage import Stage
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
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise BadSetting(f"{folder} cannot be read: {error.strerror}; make it readable") from None
    unknown = [path.name for path in paths if path.suffix != ".toml" or path.stem not in BY_NAME]
    if unknown:
        raise BadSetting(
            f"{folder} holds {', '.join(unknown)}; expected files of stages: {', '.join(BY_NAME)}"
        )
    workspace = Workspace(base.out / "tables" / name / "stages", base.out / "tables" / name)
    _write_values(workspace.stages / "raw.toml", asdict(base.raw))
    for stage in STAGES:
        settings = _settings(base, stage, folder / f"{stage.name}.toml")
        _write_values(workspace.stages / f"{stage.name}.toml", asdict(settings))
    return workspace


def _settings(base: Workspace, stage: Stage, differing: Path) -> Any:
    """The values of a stage that ship, but for those of a preset's file, which is blamed for its own faults."""
    shipped = base.settings(stage)
    path = base.stages / f"{stage.name}.toml"
    try:
        return load(stage.params, path, _differing(differing)) if os.path.lexists(differing) else shipped
    except BadSetting as error:
        raise BadSetting(str(error).replace(f"{path}: ", f"{differing}: ", 1)) from None


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
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadSetting(f"{path} cannot be read: {error.strerror}; mend or remove it") from None
    except (ValueError, RecursionError) as error:
        raise BadSetting(f"{path} is not valid TOML: {one_line(error)}") from None


def _write_values(path: Path, values: dict[str, Any]) -> None:
    write_if_changed(path, "".join(f"{key} = {_as_toml(value)}\n" for key, value in values.items()))


def _as_toml(value: Any) -> str:
    # Numbers, texts, truths and lists of them are written in TOML as in JSON; only TOML escapes a DEL.
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def _link(source: Path, target: Path) -> None:
    """The same file under a second name, or a copy of the same age where the disk knows no second names."""
    # Not the name of a part that is written into: left behind by a kill, it would be the source itself.
    second = target.with_name(f".{target.name}.link")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        second.unlink(missing_ok=True)
        if _is_same(source, target):
            return
        try:
            os.link(source, second)
        except OSError:
            shutil.copy2(source, second)
        second.replace(target)
    except OSError as error:
        if _is_same(source, target):  # another process was quicker
            return
        raise UpvlError(
            f"cannot write {target}: {error.strerror}; make room or make the folder writable"
        ) from error


def _is_same(source: Path, target: Path) -> bool:
    try:
        return target.samefile(source)
    except OSError:
        return False
