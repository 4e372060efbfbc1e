"""The command that shows a drive in 3D."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from upvl_cli.cli.application import app
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.workspace import Workspace

if TYPE_CHECKING:
    from upvl_cli.viewer.scene import DriveScene


@app.command()
def view(
    context: typer.Context,
    segment: Annotated[
        str | None, typer.Argument(help="The drive; the first labelled one when left out.")
    ] = None,
    frame_range: Annotated[
        str | None,
        typer.Option(
            help="First and last frame to show, such as 10:60; all frames without this option.",
            metavar="FIRST:LAST",
        ),
    ] = None,
    web: Annotated[
        bool,
        typer.Option(
            "--web",
            help="Show the drive in a browser on this machine, at an address that is printed; Ctrl-C ends it. Without "
            "this option the viewer opens a window where there is a display.",
        ),
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(
            help="Write the recording into this file, to be opened later or elsewhere: rerun FILE.rrd.",
            metavar="FILE.rrd",
        ),
    ] = None,
    max_points: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Maximum number of points shown of a frame; more of them are thinned evenly in space. 20000 without "
            "this option.",
        ),
    ] = None,
    all_points: Annotated[
        bool, typer.Option("--all-points", help="Show all points of each frame: none is thinned out.")
    ] = False,
    full_pictures: Annotated[
        bool,
        typer.Option(
            "--full-pictures",
            help="Show pictures at their own size; without this option they are reduced to 640 pixels along the "
            "longer side.",
        ),
    ] = False,
) -> None:
    """Show a drive in 3D, with its labels, its cameras and a time line, in the viewer of Rerun."""
    from upvl_cli.viewer.scene import MAX_POINTS, PICTURE_PX, DriveScene, ViewOptions
    from upvl_cli.viewer.sinks import has_display, saved_recording, web_viewer, window_recording

    if all_points and max_points is not None:
        raise BadSetting("both --all-points and --max-points are given: leave one out")
    if web and save is not None:
        raise BadSetting("both --web and --save are given; save first, then open the file: rerun FILE.rrd")
    workspace: Workspace = context.obj
    options = ViewOptions(
        _range_of(frame_range),
        None if all_points else max_points or MAX_POINTS,
        None if full_pictures else PICTURE_PX,
    )
    scene = DriveScene(workspace, segment or _first_drive(workspace), options)
    for line in _notes(scene):
        print(line, flush=True)
    if save is not None:
        with saved_recording(save) as recording:
            _record(recording, workspace, scene)
        print(save)
    elif web or not has_display():
        if not web:
            print("there is no display here: the viewer opens in a browser", flush=True)
        with web_viewer() as viewer:
            print(f"open {viewer.address}", flush=True)
            _record(viewer.recording, workspace, scene)
            print("all frames are there; Ctrl-C ends the viewer", flush=True)
            viewer.wait()
    else:
        with window_recording() as recording:
            _record(recording, workspace, scene)


def _range_of(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,12}):(\d{1,12})", text, re.ASCII)
    if found is None or int(found[1]) > int(found[2]):
        raise BadSetting(
            f"--frame-range {text}: expected the first and the last frame, the smaller one first, such as 10:60"
        )
    return int(found[1]), int(found[2])


def _first_drive(workspace: Workspace) -> str:
    """Return the first drive that has labels, else the first one, and say so where there are several."""
    try:
        drives = workspace.segments
    except BadInput:  # the drives are not there; their labels may be
        drives = tuple(path.stem for path in sorted((workspace.out / "labels").glob("*.parquet")))
        if not drives:
            raise
    labelled = [name for name in drives if workspace.shard("labels", name).exists()]
    chosen = (labelled or drives)[0]
    if len(drives) > 1:
        print(f"{chosen} is one of {len(drives)} drives; for another one: upvl view NAME, see: upvl segments")
    return chosen


def _notes(scene: DriveScene) -> Iterator[str]:
    """Yield what is not shown, and what is shown with less detail than there is."""
    tables, options = scene.tables, scene.options
    if tables.missing:
        yield f"not shown: {'; '.join(tables.missing)}"
    if tables.drive is None:
        return
    if options.max_points is not None:
        yield f"points thinned to {options.max_points} a frame; --all-points keeps all"
    if not scene.cameras:
        yield "the drive has no camera"
    elif options.picture_px is not None and any(
        max(camera.width_px, camera.height_px) > options.picture_px for camera in scene.cameras
    ):
        yield f"pictures reduced to {options.picture_px} pixels along the longer side; --full-pictures keeps all"


def _record(recording: object, workspace: Workspace, scene: DriveScene) -> None:
    from upvl_cli.viewer.recorder import record

    # What the texts need loads for a second: after the frames.
    def summary() -> str:
        from upvl_cli.commands.drive_notes import summary_markdown

        return summary_markdown(workspace, scene.segment)

    def sensors() -> str:
        from upvl_cli.commands.drive_notes import sensor_markdown

        return sensor_markdown(workspace, scene.segment)

    with _progress(len(scene.frames)) as tick:
        record(recording, scene, {"summary": summary, "sensors": sensors}, tick)


@contextmanager
def _progress(frames: int) -> Iterator[Callable[[], None]]:
    """Show on a terminal how many frames are done."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("frames", total=frames)
        yield lambda: bar.advance(task)
