"""What `upvl view` takes for a drive: time, bytes, memory, and the time until the first frame is there.

    python bench/view.py WORKSPACE [SEGMENT] [--frames 200]

WORKSPACE is a folder with `stages` and `out`. The frames of the drive are repeated until there are --frames of them.
Each figure is of a process of its own, from its start on:

- saved: seconds by the clock and of the processors, bytes of the recording, peak memory (MiB) with that many frames and
  with a quarter of them: the difference is what grows with the drive;
- first frame: seconds until the viewer in the browser (--web) has received the first frame.

The bars are 60 s and 150 MB for 200 frames, and 5 s for the first frame, on a machine of two cores that does nothing
else: compare the seconds of the processors where it does.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("workspace", type=Path)
    parser.add_argument("segment", nargs="?")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--child", choices=("save", "web"), help=argparse.SUPPRESS)
    parser.add_argument("--started", type=float, default=0.0, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child is not None:
        print(json.dumps(measure(asked)))
        return
    whole = in_child(asked, "save", asked.frames)
    short = in_child(asked, "save", max(1, asked.frames // 4))
    first = in_child(asked, "web", asked.frames)
    print(f"{whole['segment']}: {asked.frames} frames, {whole['drive_frames']} of the drive repeated")
    print(f"saved: {whole['seconds']:.1f} s by the clock, {whole['cpu_s']:.1f} s of the processors")
    print(f"bytes: {whole['bytes'] / 1e6:.1f} MB")
    print(f"peak: {whole['peak_mib']:.0f} MiB, {short['peak_mib']:.0f} MiB with a quarter of the frames")
    print(
        f"first frame: {first['first_s']:.1f} s by the clock, {first['first_cpu_s']:.1f} s of the processors"
    )
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


def in_child(asked: argparse.Namespace, what: str, frames: int) -> dict[str, float]:
    """Return what a process of its own measures."""
    command = [sys.executable, __file__, str(asked.workspace), *([asked.segment] if asked.segment else [])]
    command += ["--frames", str(frames), "--child", what, "--started", str(time.time())]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def measure(asked: argparse.Namespace) -> dict[str, float | str]:
    """Record the drive once, as the command does."""
    from upvl_cli.commands.pipeline import PIPELINE
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.viewer.recorder import record
    from upvl_cli.viewer.scene import DriveScene, ViewOptions
    from upvl_cli.viewer.sinks import saved_recording, web_viewer

    workspace = Workspace(PIPELINE, asked.workspace / "stages", asked.workspace / "out")
    segment = asked.segment or workspace.segments[0]
    scene = DriveScene(workspace, segment, ViewOptions())
    found: dict[str, float | str] = {"segment": segment, "drive_frames": len(scene.frames)}
    scene.frames = list(islice(cycle(scene.frames), asked.frames))
    if asked.child == "web":
        with web_viewer() as viewer:
            scene.frames = scene.frames[:4]  # a few are on their way with the first
            record(viewer.recording, scene, {}, first_tick(viewer.recording.flush, asked.started, found))
        return found
    from upvl_cli.commands.drive_notes import sensor_markdown, summary_markdown

    texts = {
        "summary": lambda: summary_markdown(workspace, segment),
        "sensors": lambda: sensor_markdown(workspace, segment),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.rrd"
        with saved_recording(path) as recording:
            record(recording, scene, texts)
        found["bytes"] = path.stat().st_size
    usage = resource.getrusage(resource.RUSAGE_SELF)
    found["seconds"] = time.time() - asked.started
    found["cpu_s"] = usage.ru_utime + usage.ru_stime
    found["peak_mib"] = usage.ru_maxrss / (1024 if sys.platform.startswith("linux") else 1024**2)
    return found


def first_tick(
    flush: Callable[[], None], started: float, found: dict[str, float | str]
) -> Callable[[], None]:
    """Return what notes the time at which the first frame has left."""

    def tick() -> None:
        if "first_s" not in found:
            flush()
            found["first_s"] = time.time() - started
            found["first_cpu_s"] = time.process_time()

    return tick


if __name__ == "__main__":
    main()
