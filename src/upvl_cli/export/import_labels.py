"""Corrected boxes come back: from an export that a person edited to a layer over the labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.tracks import velocities_of_tracks
from upvl_cli.errors import BadInput
from upvl_cli.export.corrections import (
    Corrections,
    corrected,
    corrections_path,
    labels_digest,
    read_corrections,
    write_corrections,
)
from upvl_cli.export.differences import differences
from upvl_cli.export.drive import ExportBoxes, ExportDrive, labels_of
from upvl_cli.export.format import ExportFormat
from upvl_cli.export.gather import drive_with_boxes, labelled_segments
from upvl_cli.export.manifest import Manifest, read_manifest
from upvl_cli.export.run import read_back
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.correction_rows import NEW
from upvl_cli.types import concat


@dataclass(frozen=True)
class ImportedDrive:
    """What came back of one drive.

    Attributes:
        segment: Name of the drive.
        counts: Number of labels that were kept, moved, renamed and deleted, and of new boxes.
        path: The file of the corrections.
        note: What the person should know; empty for nothing.
    """

    segment: str
    counts: Counter[str]
    path: Path
    note: str


def import_labels(
    workspace: Workspace, fmt: ExportFormat, folder: Path, segments: Collection[str]
) -> Iterator[ImportedDrive]:
    """Read edited labels, compare them with those of the workspace, and keep what a person changed.

    Every file is read before anything is written.

    Args:
        workspace: Holds the labels that were exported.
        fmt: The format of the files.
        folder: The export, or what a tool made of it.
        segments: Names of the drives; empty takes all that the folder has.

    Raises:
        BadInput: A file is missing or damaged, or the labels have been made again since the export.
        NotMade: The workspace has no labels.
    """
    known = labelled_segments(workspace, "labels", segments)
    manifest = read_manifest(folder, fmt.name) if folder.is_dir() else Manifest.unknown()
    drives = {name: drive_with_boxes(workspace, name, "labels", manifest.names) for name in known}
    for name, digest in manifest.digests.items():
        if name in drives and digest != labels_digest(workspace, name):
            raise BadInput(
                f"{folder}: the labels of {name} have been made again since this export; export them again, and "
                "repeat the corrections there"
            )
    found = read_back(fmt, folder, drives)
    results = []
    for name, edited in found.items():
        corrections, kept, note = _compare(drives[name], edited, manifest, fmt.tool_step)
        earlier = _earlier(workspace, drives[name], manifest)
        results.append((name, concat([earlier, corrections], Corrections), kept, note))
    for name, corrections, kept, note in results:
        path = write_corrections(workspace, name, drives[name].frames, corrections, kept)
        counts = Counter(corrections.change.tolist())
        yield ImportedDrive(name, Counter({**counts, "kept": kept}), path, note)


def _earlier(workspace: Workspace, drive: ExportDrive, manifest: Manifest) -> Corrections:
    """Return the earlier corrections of boxes that this export did not hold."""
    if not corrections_path(workspace, drive.name).is_file():
        return concat([], Corrections)
    earlier = read_corrections(workspace, drive.name)
    return earlier[~manifest.went_out(drive.with_boxes(earlier))]


def _compare(
    drive: ExportDrive, edited: ExportBoxes, manifest: Manifest, tool_step: float
) -> tuple[Corrections, int, str]:
    """Return what was changed in a drive, the number of labels that were kept, and a note."""
    went_out = manifest.went_out(drive)
    found = differences(drive.boxes, edited, went_out, tool_step)
    emptied = np.setdiff1d(drive.boxes.frame[went_out], edited.frame)
    notes = []
    if drive.name not in manifest.digests:
        notes.append("upvl.json of the export is missing: every label that is not there counts as deleted")
    if len(emptied):
        notes.append(f"{len(emptied)} frames came back without any box: their labels count as deleted")
    return _with_velocities(drive, found.corrections), found.kept, "; ".join(notes)


def _with_velocities(drive: ExportDrive, corrections: Corrections) -> Corrections:
    """Return the corrections with the velocity that a new box has by its track."""
    unknown = (corrections.change == NEW) & np.isnan(corrections.velocity_mps).any(axis=1)
    if not unknown.any():
        return corrections
    boxes, _ = corrected(drive.boxes, corrections)
    of_tracks = velocities_of_tracks(labels_of(boxes), drive.frames, drive.world_from_ego)
    known = {key: velocity for key, velocity in zip(_keys(boxes), of_tracks, strict=True)}
    velocity = corrections.velocity_mps.copy()
    for place in np.flatnonzero(unknown):
        velocity[place] = known[_keys(corrections[place : place + 1])[0]]
    return replace(corrections, velocity_mps=velocity)


def _keys(boxes: ExportBoxes) -> list[tuple[int, int]]:
    return list(zip(boxes.frame.tolist(), boxes.track_id.tolist(), strict=True))
