"""One export: from the drives of a workspace to a new folder, whole or not at all; and the way back."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput, BadSetting, UpvlError, one_line
from upvl_cli.export.classes import count_unknown, extended_class_map, renamed, upvl_names
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ALL, ExportFormat, ExportOptions
from upvl_cli.export.manifest import MANIFEST, Manifest, exported_frames, read_manifest
from upvl_cli.geometry.boxes import check_finite


def export(
    drives: Iterable[ExportDrive], fmt: ExportFormat, folder: Path, options: ExportOptions, losses: Losses
) -> dict[str, int]:
    """Write drives into a new folder and return what the format could not carry, by reason.

    Args:
        drives: The drives, one after the other.
        fmt: The format.
        folder: It is made; an earlier export in it is replaced.
        options: Choices of the export.
        losses: What was lost before, and is told with the rest.

    Raises:
        BadSetting: The folder holds something else than an export.
        UpvlError: It cannot be written.
    """
    _check_target(folder)
    classes: dict[str, str] = {}
    frames: dict[str, dict[str, list[list[int]]]] = {}

    def in_words_of_the_format() -> Iterator[ExportDrive]:
        for drive in drives:
            check_finite(drive.boxes)
            frames[drive.name] = exported_frames(drive)
            count_unknown(drive.boxes.class_name, fmt, losses)
            present = [str(name) for name in np.unique(drive.boxes.class_name)]
            classes.update(extended_class_map(classes, present, fmt))
            for reason in sorted(ALL - fmt.carries):
                losses[f"{reason}, for which the format has no place"] += len(drive.boxes)
            named = replace(drive.boxes, class_name=renamed(drive.boxes.class_name, classes))
            yield drive.with_boxes(named)

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            fmt.write(in_words_of_the_format(), part, options, losses)
            not_carried = {reason: int(count) for reason, count in sorted(losses.items()) if count}
            native = {native: name for name, native in sorted(classes.items())}
            manifest = Manifest(fmt.name, options.names, native, dict(options.digests), frames, not_carried)
            text = json.dumps(manifest.as_json(), indent=1) + "\n"
            (part / MANIFEST).write_text(text, encoding="utf-8")
            part.chmod(0o755)
            _replace(part, folder)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise UpvlError(
            f"cannot write {folder}: {error.strerror or one_line(error)}; make room or name another folder"
        ) from error
    return not_carried


def read_back(fmt: ExportFormat, folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of an export, or of what a tool made of it, in the words of upvl.

    Args:
        fmt: The format.
        folder: What is read.
        drives: Frames, poses and cameras of the drives that are known.

    Raises:
        BadInput: A file is missing or damaged, a box is none, or the folder is of another format.
        BadSetting: Boxes do not come back from this format.
    """
    if fmt.read is None:
        raise BadSetting(f"boxes in three dimensions do not come back from the format {fmt.name}")
    if not folder.exists():
        raise BadInput(f"{folder} is missing; name the folder that holds labels in the format {fmt.name}")
    manifest = read_manifest(folder, fmt.name) if folder.is_dir() else Manifest.unknown()
    words = upvl_names(fmt, manifest.classes)
    found = {}
    for name, boxes in fmt.read(folder, drives).items():
        _check_boxes(boxes, drives[name], folder)
        boxes = replace(boxes, class_name=renamed(boxes.class_name, words))
        found[name] = boxes[np.argsort(boxes.frame, kind="stable")]
    if not found:
        known = ", ".join(list(drives)[:3])
        raise BadInput(f"{folder} has no labels of a drive of this workspace ({known}); see: upvl segments")
    return found


def _check_boxes(boxes: ExportBoxes, drive: ExportDrive, folder: Path) -> None:
    rows = boxes.to_rows()
    wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1) | ~(boxes.size_lwh_m > 0).all(axis=1))
    if len(wrong):
        raise BadInput(
            f"{folder}: box {boxes.track_id[wrong[0]]} of frame {boxes.frame[wrong[0]]} of {drive.name} has no size or "
            "no place; expected finite numbers and sizes above 0"
        )
    drive.places_of(boxes.frame)
    keys = np.column_stack([boxes.frame, boxes.track_id])
    found, count = np.unique(keys, axis=0, return_counts=True)
    if (count > 1).any():
        frame, track = found[count > 1][0]
        raise BadInput(
            f"{folder}: frame {frame} of {drive.name} has two boxes of track {track}; expected one"
        )


def _check_target(folder: Path) -> None:
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise BadSetting(f"{folder} is no folder; name a new one")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / MANIFEST).is_file():
        raise BadSetting(f"{folder} holds files that no export made; name a new folder")


def _replace(part: Path, folder: Path) -> None:
    """Put a folder into its place; the earlier export goes when the new one is there."""
    if not folder.exists():
        part.rename(folder)
        return
    old = part.with_name(f"{part.name}.old")
    folder.rename(old)
    os.rename(part, folder)
    shutil.rmtree(old, ignore_errors=True)
