"""The command that makes a drive from a recording of one's own sensors."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from upvl_cli.cli.application import app


@app.command("import")
def import_recording(
    source: Annotated[
        Path, typer.Argument(help="A folder of point files, a SUSTechPOINTS scene, or a ROS recording.")
    ],
    folder: Annotated[
        Path, typer.Argument(help="Folder of drives to write into; it is made where it is missing.")
    ],
    segment: Annotated[str, typer.Option(help="Name of the drive; that of the source when left out.")] = "",
    poses: Annotated[
        Path | None,
        typer.Option(
            help="File of the LiDAR's poses: TUM, KITTI, or CSV with a header; odometry when left out."
        ),
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(help="File of one time stamp a line; the names of the sweeps when left out."),
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option(help="Sweeps a second, where nothing tells their times.", min=0.1, max=1000),
    ] = None,
    axes: Annotated[
        str,
        typer.Option(help="Where x, y and z of the points lead: f, b, l, r, u or d each, for example rfu."),
    ] = "flu",
    mount: Annotated[
        Path | None,
        typer.Option(
            help="File with the 4 x 4 pose of the LiDAR in the body whose poses are given (IMU, camera)."
        ),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option(help="TOML file of cameras and their folders of pictures, for a folder of point files."),
    ] = None,
    topics: Annotated[
        Path | None,
        typer.Option(help="TOML file that maps the topics of a ROS recording; proposed when left out."),
    ] = None,
    intensity_max: Annotated[
        float | None,
        typer.Option(help="The intensity that 1 stands for; seen from the recording when left out.", min=0),
    ] = None,
    compensated: Annotated[
        bool,
        typer.Option(
            "--compensated", help="Points are motion-compensated already, although they have times."
        ),
    ] = False,
    car_m: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Drop points on the own car: x from, x to, y from, y to around its origin, in m."),
    ] = None,
) -> None:
    """Make a drive from a recording of your own sensors; one that was stopped goes on where it was."""
    from upvl_cli.commands.import_drive import ImportRequest, ScanOptions, import_drive

    scan = ScanOptions(poses, times, rate_hz, axes, mount, cameras)
    request = ImportRequest(source, folder, segment, scan, topics, intensity_max, compensated, car_m)
    with ImportProgress() as progress:
        summary = import_drive(request, progress.advance)
    for line in summary_lines(summary, folder):
        print(line)


class ImportProgress:
    """How far an import is: a bar for sweeps and one for pictures, on a terminal alone."""

    def __init__(self) -> None:
        from rich import progress as bars
        from rich.console import Console

        self._tasks: dict[str, Any] = {}
        self._done: dict[str, int] = {}
        self._bars = bars.Progress(
            bars.TextColumn("{task.description}"),
            bars.BarColumn(),
            bars.MofNCompleteColumn(),
            bars.TextColumn("{task.fields[rate]:.1f} a second"),
            bars.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=not sys.stderr.isatty(),
        )

    def __enter__(self) -> ImportProgress:
        """Show the bars."""
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bars away."""
        self._bars.stop()

    def advance(self, what: str, count: int, total: int) -> None:
        """Count more of something."""
        if what not in self._tasks:
            # What an earlier run did is no part of the rate.
            self._tasks[what] = self._bars.add_task(what, total=total, rate=0.0)
        task = self._bars.tasks[self._tasks[what]]
        self._done[what] = self._done.get(what, 0) + (count if count == 1 else 0)
        rate = self._done[what] / task.elapsed if task.elapsed else 0.0
        self._bars.update(self._tasks[what], advance=count, rate=rate)


def summary_lines(summary: Any, folder: Path) -> list[str]:
    """Return what was done, what was left out and why, and what to do next."""
    counts = summary.counts
    lines = [f"{summary.segment}: there already, of the same files and settings"] if summary.was_there else []
    lines += list(summary.notes)
    cameras = f", {counts.pictures} pictures of {len(summary.cameras)} cameras" if summary.cameras else ""
    lines.append(f"{summary.segment}: {counts.frames} sweeps, {counts.points} points{cameras}")
    for reason, count in counts.skipped.items():
        example = counts.examples.get(reason)
        lines.append(f"left out: {count} {reason}" + (f"; the first: {example}" if example else ""))
    lines += [
        "",
        "in stages/raw.toml:",
        'dataset = "parquet"',
        f'root = "{folder.resolve()}"',
        "segments = []",
        "",
        "then: upvl autolabel --moving-only && upvl draw",
    ]
    return lines
