"""A drive as a recording for the viewer of Rerun."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from upvl_cli.commands.drive_notes import sensor_markdown, summary_markdown
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.viewer.recorder import record
from upvl_cli.viewer.scene import DriveScene, ViewOptions
from upvl_cli.viewer.sinks import has_display, saved_recording, window_recording


def save_recording(
    workspace: Workspace, segment: str, frame_range: tuple[int, int] | None, path: Path
) -> Path:
    """Write a drive into a file and return its path.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
        frame_range: First and last frame; None takes all.
        path: The file.
    """
    scene = DriveScene(workspace, segment, ViewOptions(frame_range))
    with saved_recording(path) as recording:
        record(recording, scene, _texts(workspace, segment))
    return path


def show_recording(workspace: Workspace, segment: str, frame_range: tuple[int, int] | None) -> None:
    """Show a drive in the viewer's window, which stays.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
        frame_range: First and last frame; None takes all.

    Raises:
        BadSetting: There is no display.
    """
    if not has_display():
        raise BadSetting(
            'there is no display for a window; name a file: to_rerun("drive.rrd"), or run: upvl view'
        )
    scene = DriveScene(workspace, segment, ViewOptions(frame_range))
    with window_recording() as recording:
        record(recording, scene, _texts(workspace, segment))


def _texts(workspace: Workspace, segment: str) -> Mapping[str, Callable[[], str]]:
    return {
        "summary": partial(summary_markdown, workspace, segment),
        "sensors": partial(sensor_markdown, workspace, segment),
    }
