"""Time and size of `upvl report`: python bench/report.py WORKSPACE [--drives 5 50].

Takes the first labelled drive of a workspace and repeats it under other names: with the built-in drive of 40 frames,
five drives are the 200 frames of the bar, and fifty show that the page stays small. Prints the seconds of CPU and those
that passed (they differ on a busy machine), and the size of the page; exits 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from machine import Stolen
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.run import write_report

BAR_FRAMES, BAR_S, BAR_BYTES = 200, 20.0, 10_000_000


class RepeatedDrive(Workspace):
    """A workspace whose drives are all the same one."""

    first = ""
    names: tuple[str, ...] = ()

    @property
    def segments(self) -> tuple[str, ...]:  # type: ignore[override]
        """The names of the copies."""
        return self.names

    def drive(self, segment: str):  # type: ignore[no-untyped-def] # noqa: ANN201
        """Return the one drive."""
        if self.first not in self._drives:
            self._drives = {self.first: self.dataset.open(self.first)}
        return self._drives[self.first]


def repeat(source: Workspace, first: str, drives: int, folder: Path) -> RepeatedDrive:
    """Link the shards of a drive under other names."""
    names = tuple(f"copy-{number:03d}" for number in range(drives))
    for stage in PIPELINE.stages:
        shared = source.shard(stage.name, WHOLE_DATASET)
        for path, targets in ((source.shard(stage.name, first), names), (shared, (WHOLE_DATASET,))):
            for name in targets if path.exists() else ():
                target = folder / stage.name / f"{name}.parquet"
                target.parent.mkdir(parents=True, exist_ok=True)
                target.symlink_to(path.resolve())
    workspace = RepeatedDrive(PIPELINE, source.stages, folder)
    workspace.first, workspace.names = first, names
    return workspace


def main() -> None:
    """Write the pages, print, and compare with the bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--drives", type=int, nargs="+", default=[5, 50])
    options = parser.parse_args()
    source = Workspace(PIPELINE, options.workspace / "stages", options.workspace / "out")
    first = next(name for name in source.segments if source.shard("labels", name).exists())
    missed = False
    for drives in options.drives:
        with tempfile.TemporaryDirectory() as folder:
            workspace = repeat(source, first, drives, Path(folder))
            stolen, cpu, clock = Stolen(), time.process_time(), time.perf_counter()
            written = write_report(workspace, (), Path(folder) / "report.html")
            cpu_s, passed_s = time.process_time() - cpu, time.perf_counter() - clock
        frames = drives * len(source.drive(first).frames)
        print(
            f"{drives} drives, {frames} frames: {cpu_s:.1f} s of CPU, {passed_s:.1f} s passed ({stolen}), "
            f"{written.size_bytes / 1e6:.2f} MB"
        )
        missed |= written.size_bytes > BAR_BYTES or (frames <= BAR_FRAMES and cpu_s > BAR_S)
    print(
        f"bars: {BAR_S:g} s of CPU for {BAR_FRAMES} frames, {BAR_BYTES / 1e6:g} MB for any number of drives"
    )
    raise SystemExit(missed)


if __name__ == "__main__":
    main()
