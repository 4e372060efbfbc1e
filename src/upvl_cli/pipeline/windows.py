"""A long drive made in windows of frames, by several processes or machines, and joined to the same shard.

A window is a shard of its own, `out/<stage>/.parts/<segment>/<first>-<end>/<segment>.parquet`, with a stamp. Only a
stage that is `windowed` can be made so: it computes each frame from its inputs alone, whichever frames it yields. What
a frame needs of its neighbours is read from the inputs, beyond the ends of the window too, so that windows overlap in
what they read and not in what they write.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from upvl_cli.config.base import Config
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.provenance import to_json
from upvl_cli.pipeline.runner import CheckedRows, Made, Tick, make_shard, prepare_inputs, state
from upvl_cli.pipeline.stage import FrameWindow, Row
from upvl_cli.pipeline.tables import Table, read_footer, write
from upvl_cli.pipeline.workspace import Workspace


def windows_of(workspace: Workspace, segment: str, windows: int) -> tuple[FrameWindow, ...]:
    """Return windows of nearly equal numbers of frames that cover a drive: the same for the same number of them.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
        windows: How many; a drive of fewer frames has one for each frame.
    """
    frames = [frame.index for frame in workspace.drive(segment).frames]
    windows = max(min(windows, len(frames)), 1)
    starts = [frames[number * len(frames) // windows] for number in range(1, windows)] if frames else []
    ends = [*starts, frames[-1] + 1 if frames else 1]
    return tuple(FrameWindow(first, end) for first, end in zip([0, *starts], ends, strict=True))


def make_window(
    workspace: Workspace, stage: AnyStage, segment: str, window: FrameWindow, settings: Config, tick: Tick
) -> bool:
    """Make the rows of a window of a drive; return whether they had to be made.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        segment: Name of the drive.
        window: The frames to make.
        settings: Values of the stage.
        tick: Called after each frame.

    Raises:
        BadSetting: The stage needs the drive as a whole.
        NotMade: An input is missing or was made with other settings.
    """
    _check_windowed(stage)
    prepare_inputs(workspace, stage, segment, settings)
    path, stamp = (
        _part(workspace, stage, segment, window),
        _stamp(workspace, stage, segment, window, settings),
    )

    def is_needed() -> bool:
        return (
            not _is_whole(path, stamp) and state(workspace, stage, segment, settings)[0] != "fresh"
        )  # the shard may have been joined meanwhile

    if not is_needed():
        return False
    inputs = ShardInputs(workspace, stage, segment, settings, tick, window)
    rows = CheckedRows(stage.run(inputs, settings), segment, tick)
    found = write(path, stage.row, iter(rows), stamp=stamp, counts=inputs.counts, needed=is_needed)
    return found is not None


def missing_windows(
    workspace: Workspace, stage: AnyStage, segment: str, windows: Sequence[FrameWindow], settings: Config
) -> list[FrameWindow]:
    """Return the windows of a drive that are not made, or were made from other inputs or with other settings."""
    return [
        window
        for window in windows
        if not _is_whole(
            _part(workspace, stage, segment, window), _stamp(workspace, stage, segment, window, settings)
        )
    ]


def join_windows(
    workspace: Workspace, stage: AnyStage, segment: str, windows: Sequence[FrameWindow], settings: Config
) -> Made:
    """Write the shard of a drive from its windows, with the bytes that the stage would have given; delete the windows.

    Any number of processes may call this at the same time, and again after a stop.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        segment: Name of the drive.
        windows: All windows of the drive.
        settings: Values of the stage.

    Raises:
        BadSetting: The stage needs the drive as a whole.
        NotMade: A window, or an input, is missing or was made with other settings.
    """
    _check_windowed(stage)

    def rows_of(inputs: ShardInputs) -> Iterator[Row]:
        missing = missing_windows(workspace, stage, segment, windows, settings)
        if missing:
            names = ", ".join(_name(window) for window in missing[:5])
            raise NotMade(
                f"{stage.name} of {segment}: {len(missing)} of {len(windows)} windows are not made ({names}); make them"
            )
        for window in windows:
            path = _part(workspace, stage, segment, window)
            footer = read_footer(path)
            for reason, items in footer.counts.items() if footer else ():
                inputs.count(reason, items)
            yield from Table(path, stage.row)

    made = make_shard(workspace, stage, segment, settings, _no_tick, rows_of)
    _delete(workspace, stage, segment)
    return made


def run_window(workspace: Workspace, stage: AnyStage, segment: str, window: Share, settings: Config) -> str:
    """Make one of the windows of a drive, join all where none is missing, and return in words what became of it.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        segment: Name of the drive.
        window: Which window, of how many.
        settings: Values of the stage.

    Raises:
        BadSetting: The stage needs the drive as a whole.
        NotMade: An input is missing or was made with other settings.
    """
    windows = windows_of(workspace, segment, window.count)
    if window.number > len(windows):
        return f"it has {len(windows)} frames, and no window {window.number}"
    made = make_window(workspace, stage, segment, windows[window.number - 1], settings, _no_tick)
    missing = missing_windows(workspace, stage, segment, windows, settings)
    if missing and state(workspace, stage, segment, settings)[0] != "fresh":
        done = "made" if made else "was made"
        return f"window {window.number} of {len(windows)} {done}, {len(missing)} missing"
    join_windows(workspace, stage, segment, windows, settings)
    return "all windows are made; the shard is fresh"


def _check_windowed(stage: AnyStage) -> None:
    if not stage.windowed:
        raise BadSetting(f"{stage.name} needs the whole drive and cannot be made in windows; make its shard")


def _folder(workspace: Workspace, stage: AnyStage, segment: str) -> Path:
    return workspace.out / stage.name / ".parts" / segment


def _part(workspace: Workspace, stage: AnyStage, segment: str, window: FrameWindow) -> Path:
    return _folder(workspace, stage, segment) / _name(window) / f"{segment}.parquet"


def _name(window: FrameWindow) -> str:
    return f"{window.first:08d}-{window.end:08d}"


def _stamp(workspace: Workspace, stage: AnyStage, segment: str, window: FrameWindow, settings: Config) -> str:
    """Return the stamp of the shard, and the window."""
    of_drive = json.loads(workspace.shard_stamp(stage, segment, settings))
    return to_json(of_drive | {"window": {"first": window.first, "end": window.end}})


def _is_whole(path: Path, stamp: str) -> bool:
    footer = read_footer(path)
    return footer is not None and footer.stamp == stamp


def _delete(workspace: Workspace, stage: AnyStage, segment: str) -> None:
    """Delete all windows of a drive, those of other cuts too; another process may be at the same."""
    folder = _folder(workspace, stage, segment)
    for path in sorted(folder.glob(f"*/{segment}.parquet")):
        path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            path.parent.rmdir()
    for empty in (folder, folder.parent):
        with contextlib.suppress(OSError):
            empty.rmdir()


def _no_tick() -> None:
    """Count nothing: the frames were counted when they were made."""
