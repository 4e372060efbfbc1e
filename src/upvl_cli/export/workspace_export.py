"""The boxes of a workspace that an export takes, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.export.corrections import labels_digest
from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.gather import SelectBoxes, drive_with_boxes, labelled_segments, selected
from upvl_cli.export.hits import drives_of_hits
from upvl_cli.export.manifest import NAMES
from upvl_cli.export.run import export
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.classes import classes_from_phrases
from upvl_cli.query.config import QueryConfig
from upvl_cli.query.filters import Filters
from upvl_cli.query.run import Request, answer
from upvl_cli.types import Array, Bools

WatchDrives = Callable[[Iterable[ExportDrive], int], Iterable[ExportDrive]]


@dataclass(frozen=True)
class BoxChoice:
    """Which boxes are exported.

    Attributes:
        what: A key of `gather.STAGE_OF`.
        names: "class" or "word".
        classes: Classes, or words, that are taken; empty takes all.
        filters: Bounds on boxes.
    """

    what: str
    names: str
    classes: tuple[str, ...]
    filters: Filters


@dataclass
class ExportSummary:
    """What an export came to: its drives, boxes and hand corrections, and what the format could not carry."""

    drives: int = 0
    frames: int = 0
    boxes: int = 0
    left_out: int = 0
    corrected_drives: int = 0
    not_carried: Mapping[str, int] | None = None

    def lines(self, folder: Path) -> Iterator[str]:
        """Yield what a user is told."""
        drives = "1 drive" if self.drives == 1 else f"{self.drives} drives"
        yield f"{folder}: {self.boxes} boxes in {self.frames} frames of {drives}"
        if self.left_out:
            yield f"  {self.left_out} boxes left out by the filters"
        if self.corrected_drives:
            yield f"  drives with hand corrections: {self.corrected_drives}; without corrections: --on labels"
        for reason, count in (self.not_carried or {}).items():
            yield f"  {reason}: {count}"


@dataclass(frozen=True)
class _Filterable:
    """The boxes of a drive as filters see them."""

    drive: ExportDrive

    def __len__(self) -> int:
        return len(self.drive.boxes)

    @property
    def speed_mps(self) -> Array:
        velocity = self.drive.boxes.velocity_mps
        return np.asarray(np.hypot(velocity[:, 0], velocity[:, 1]))

    @property
    def range_m(self) -> Array:
        center = self.drive.boxes.center_m
        return np.asarray(np.hypot(center[:, 0], center[:, 1]))

    @property
    def time_s(self) -> Array:
        times = self.drive.times_ns
        return np.asarray((times[self.drive.places] - (times[0] if len(times) else 0)) * 1e-9)

    @property
    def confidence(self) -> Array:
        return self.drive.boxes.score


def export_workspace(
    workspace: Workspace,
    fmt: ExportFormat,
    folder: Path,
    choice: BoxChoice,
    options: ExportOptions,
    watch: WatchDrives,
) -> ExportSummary:
    """Export boxes of a workspace and return what it came to.

    Args:
        workspace: Holds the labels or detections.
        fmt: The format.
        folder: It is made; an earlier export in it is replaced.
        choice: Which boxes.
        options: Choices of the export.
        watch: Is handed the drives as they are written, and how many there are.

    Raises:
        BadSetting: A name, a class or the folder is wrong.
        NotMade: There are no such boxes.
    """
    if choice.names not in NAMES:
        raise BadSetting(f"--names {choice.names}: expected {' or '.join(NAMES)}")
    segments = labelled_segments(workspace, choice.what, choice.filters.segments)
    moving_mps = load(QueryConfig, workspace.stages / "query.toml", {}).moving_mps
    summary = ExportSummary()

    def select(drive: ExportDrive) -> Bools:
        taken = choice.filters.mask(_Filterable(drive), moving_mps)
        if choice.classes:
            taken &= np.isin(drive.boxes.class_name, choice.classes)
        summary.left_out += int((~taken).sum())
        summary.corrected_drives += drive.deleted is not None
        return taken

    drives = (drive_with_boxes(workspace, name, choice.what, choice.names) for name in segments)
    digests = {name: labels_digest(workspace, name) for name in segments if choice.what != "detections"}

    def write(drives: Iterable[ExportDrive], losses: Losses) -> dict[str, int]:
        return export(watch(drives, len(segments)), fmt, folder, replace(options, digests=digests), losses)

    return _exported(drives, select, write, summary)


def export_query(
    workspace: Workspace,
    fmt: ExportFormat,
    folder: Path,
    asked: tuple[str, str | None, Filters],
    options: ExportOptions,
    watch: WatchDrives,
) -> ExportSummary:
    """Export the hits of a query and return what it came to.

    Args:
        workspace: Holds the labels or detections.
        fmt: The format.
        folder: It is made; an earlier export in it is replaced.
        asked: The words, separated by commas; "labels", "detections" or None; bounds on boxes.
        options: Choices of the export.
        watch: Is handed the drives as they are written, and how many there are.

    Raises:
        BadSetting: A word is likely misspelt, or a drive is unknown.
        NotMade: There is nothing to search yet.
    """
    words, source, filters = asked
    classes = classes_from_phrases([words])
    request = Request(classes, words, source, filters, sheet=False, check_spelling=True, values={})
    found = answer(workspace, request)
    hits = found.result.hits
    drives = drives_of_hits(workspace, found.source, hits, found.vocabulary.class_names)

    def select(drive: ExportDrive) -> Bools:
        return np.ones(len(drive.boxes), dtype=np.bool_)

    def write(drives: Iterable[ExportDrive], losses: Losses) -> dict[str, int]:
        return export(watch(drives, len(np.unique(hits.segment))), fmt, folder, options, losses)

    return _exported(drives, select, write, ExportSummary())


def _exported(
    drives: Iterable[ExportDrive],
    select: SelectBoxes,
    write: Callable[[Iterable[ExportDrive], Losses], dict[str, int]],
    summary: ExportSummary,
) -> ExportSummary:
    """Write the boxes that are taken, and return the summary with what was written and lost."""
    losses = Losses()

    def counted() -> Iterator[ExportDrive]:
        for drive in selected(drives, select, losses):
            summary.drives += 1
            summary.frames += len(drive.frames)
            summary.boxes += len(drive.boxes)
            yield drive

    summary.not_carried = write(counted(), losses)
    return summary
