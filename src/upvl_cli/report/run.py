"""Write the report of a run as one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.page import render_page
from upvl_cli.report.run_summary import gather_summary, labelled_drives, read_drives
from upvl_cli.runtime.atomic import atomic_file

MOST_BYTES = 10_000_000


@dataclass(frozen=True)
class WrittenReport:
    """A report on disk: its path, its size, and what it could not show, one sentence each."""

    path: Path
    size_bytes: int
    notes: tuple[str, ...]


def write_report(
    workspace: Workspace, segments: Sequence[str], path: Path, against: Path | None = None
) -> WrittenReport:
    """Write the report of a run.

    Args:
        workspace: The workspace of the run.
        segments: Names of the drives; empty takes all that have labels.
        path: Where the page goes.
        against: Folder of another run's results to compare with; None for no comparison.

    Raises:
        BadSetting: There is no such drive, or the folders are the same or hold nothing to compare.
        NotMade: No drive has been labelled.
        UpvlError: The page cannot be written.
    """
    if path.is_dir():
        raise BadSetting(f"--to {path}: this is a folder; name a file in it, such as {path / 'report.html'}")
    if against is not None and against.exists() and against.resolve() == workspace.out.resolve():
        raise BadSetting(
            f"--against {against}: this is the folder of the results themselves; name another run's"
        )
    names, unlabelled = labelled_drives(workspace, segments)
    drives = read_drives(workspace, names)
    summary = gather_summary(workspace, drives, unlabelled)
    changes = None
    if against is not None:
        from upvl_cli.report.changes import gather_changes  # loads SciPy's optimizer

        changes = gather_changes(workspace, against, drives, summary)
        summary.missing += changes.missing
    page = render_page(summary, changes).encode("utf-8", "replace")
    with atomic_file(path) as file:
        file.write(page)
    notes = [f"missing: {part.what} ({part.reason})" + (f"; run: {part.command}" if part.command else "")
             for part in summary.missing]  # fmt: skip
    return WrittenReport(path, len(page), tuple(notes))
