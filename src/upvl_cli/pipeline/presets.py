"""Run presets, each a few values that differ from those of `stages/*.toml`, and make no shard twice."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.pipeline import AnyStage, Pipeline
from upvl_cli.pipeline.preset_files import join_presets, preset_folder
from upvl_cli.pipeline.runner import Made, Tick, claim_folder, make_shard
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file, write_if_changed


def checked_preset(pipeline: Pipeline, stages: Path, name: str) -> str:
    """Return the name of a preset after a look at its folder, which holds nothing but values of stages.

    Raises:
        BadSetting: There is no such preset, or it holds a file that no stage knows.
    """
    folder = preset_folder(stages, name)
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise BadSetting(f"{folder} cannot be read: {error.strerror}; make it readable") from None
    unknown = [path.name for path in paths if path.suffix != ".toml" or path.stem not in pipeline.by_name]
    if unknown:
        raise BadSetting(
            f"{folder} holds {', '.join(unknown)}; expected files of stages: {', '.join(pipeline.by_name)}"
        )
    return name


def preset_workspace(base: Workspace, name: str) -> Workspace:
    """Return the workspace of a preset, with its shards in `out/tables/<name>`.

    Args:
        base: The workspace that it differs from.
        name: A folder of `stages/presets`.

    Raises:
        BadSetting: There is no such preset, or it holds a file or a value that no stage knows.
    """
    workspace = Workspace(
        base.pipeline,
        base.stages,
        base.out / "tables" / name,
        checked_preset(base.pipeline, base.stages, name),
    )
    for stage in base.pipeline.stages:
        workspace.settings(stage)
    note_preset(workspace)
    return workspace


def with_preset(base: Workspace, name: str, stages: Sequence[AnyStage]) -> Workspace:
    """Return the workspace with a preset in place of those that change the same stages, and note it in its folder.

    Args:
        base: The workspace before the change.
        name: A folder of `stages/presets`; "" leaves the stages with the values of their TOML files.
        stages: The stages whose values the preset replaces.

    Raises:
        BadSetting: There is no such preset, or it holds a file that no stage knows.
    """
    others = [part for part in base.presets if not any(base.preset_file(part, stage) for stage in stages)]
    # A preset without any file changes no stage, and is dropped with the rest.
    kept = [part for part in others if any(base.preset_file(part, stage) for stage in base.pipeline.stages)]
    chosen = [checked_preset(base.pipeline, base.stages, name)] if name else []
    workspace = Workspace(base.pipeline, base.stages, base.out, join_presets([*kept, *chosen]))
    note_preset(workspace)
    return workspace


def note_preset(workspace: Workspace) -> None:
    """Write to the folder of the shards which preset they are made with: later commands use it."""
    path = workspace.out / "preset"
    if workspace.preset or path.exists():
        write_if_changed(path, f"{workspace.preset}\n")


def make_labels(
    base: Workspace, workspace: Workspace, others: Sequence[Workspace], segment: str, tick: Tick
) -> Iterator[Made]:
    """Make the labelling shards of a segment; one that another workspace makes from equal values is linked.

    Args:
        base: The workspace that all presets differ from; the first to lend a shard with an equal stamp.
        workspace: The workspace whose shards are made.
        others: Presets that have been made; the next to lend a shard with an equal stamp.
        segment: Name of the drive.
        tick: Called after each frame.

    Raises:
        UpvlError: A shard cannot be made or written.
    """
    _link(base.mark_raw(segment), workspace.shard("raw", segment))
    for stage in base.pipeline.labelling_stages:
        drive = WHOLE_DATASET if stage.is_of_dataset else segment
        yield _make_or_link(base, workspace, others, stage, drive, tick)


def make_detector(
    base: Workspace, workspace: Workspace, others: Sequence[Workspace], segments: Sequence[str], tick: Tick
) -> Iterator[Made]:
    """Make the detector of a workspace whose labels are made, and what it finds.

    Args:
        base: As for `make_labels`.
        workspace: The workspace whose detector is trained.
        others: As for `make_labels`.
        segments: Names of the drives in which the detector looks for objects.
        tick: Called after each step and each frame.

    Raises:
        UpvlError: A shard cannot be made or written.
    """
    for stage in base.pipeline.later_stages:
        for drive in (WHOLE_DATASET,) if stage.is_of_dataset else segments:
            yield _make_or_link(base, workspace, others, stage, drive, tick)


def _make_or_link(
    base: Workspace,
    workspace: Workspace,
    others: Sequence[Workspace],
    stage: AnyStage,
    drive: str,
    tick: Tick,
) -> Made:
    """Make a shard where the first workspace with equal values for it is, and link it from there."""
    stamp = workspace.shard_stamp(stage, drive)
    owner = next((other for other in (base, *others) if other.shard_stamp(stage, drive) == stamp), workspace)
    made = make_shard(owner, stage, drive, claim_folder(owner, stage, {}), tick)
    if owner is not workspace:
        claim_folder(workspace, stage, {})
        _link(owner.shard(stage.name, drive), workspace.shard(stage.name, drive))
    return made


def _link(source: Path, target: Path) -> None:
    """Link a file under a second name, or copy it with its age where the file system has no links."""
    if is_remote(target):
        with atomic_file(target) as file:
            file.write(source.read_bytes())
        return
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
