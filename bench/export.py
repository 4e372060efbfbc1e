"""Every format on the labels of workspaces: what comes back, how far off, how long it takes and how large it is.

    python bench/export.py WORKSPACE [WORKSPACE ...]

Prints for each workspace and format the largest error of centres, headings and sizes, whether ids and
classes are equal, the seconds of export and reading, and the bytes of a box.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.export.format import TRACK, ExportFormat, ExportOptions
from upvl_cli.export.formats import FORMATS, export_format
from upvl_cli.export.gather import drive_with_boxes, labelled_segments
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.pipeline.workspace import Workspace


def main() -> None:
    """Measure each workspace that is named."""
    for name in sys.argv[1:]:
        folder = Path(name)
        workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
        segments = labelled_segments(workspace, "labels", ())
        drives = [drive_with_boxes(workspace, segment, "labels", "class") for segment in segments]
        boxes = sum(len(drive.boxes) for drive in drives)
        print(f"{folder.name}: {len(drives)} drives, {boxes} boxes")
        for format_name in FORMATS:
            print(f"  {format_name:18}" + measured(export_format(format_name), drives, boxes))


def measured(fmt: ExportFormat, drives: list[ExportDrive], boxes: int) -> str:
    """Return one line on a format."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "to"
        start = time.perf_counter()
        export(drives, fmt, folder, ExportOptions(), Counter())
        written_s = time.perf_counter() - start
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        cost = f"{written_s:6.2f} s out, {size / max(boxes, 1):7.0f} bytes a box"
        if fmt.read is None:
            return f" {cost}; boxes do not come back"
        start = time.perf_counter()
        found = read_back(fmt, folder, {drive.name: drive for drive in drives})
        cost = f"{cost}, {time.perf_counter() - start:6.2f} s back"
    return f" {errors(fmt, drives, found)}, {cost}"


def errors(fmt: ExportFormat, drives: list[ExportDrive], found: dict[str, ExportBoxes]) -> str:
    """Return by how much the boxes that came back differ."""
    pairs = [(in_order(drive.boxes), in_order(found[drive.name])) for drive in drives if len(drive.boxes)]
    if any(len(before) != len(after) for before, after in pairs):
        return "ANOTHER NUMBER OF BOXES"
    center = max(np.abs(after.center_m - before.center_m).max() for before, after in pairs)
    size = max(np.abs(after.size_lwh_m - before.size_lwh_m).max() for before, after in pairs)
    turn = max(np.abs(wrap_angle(after.heading_rad - before.heading_rad)).max() for before, after in pairs)
    same_id = all((before.track_id == after.track_id).all() for before, after in pairs)
    same_class = all((before.class_name == after.class_name).all() for before, after in pairs)
    ids = ("equal" if same_id else "DIFFERENT") if TRACK in fmt.carries else "not carried"
    return (
        f"centre {center * 1e3:.4f} mm, heading {np.rad2deg(turn):.6f} deg, size {size * 1e3:.4f} mm, ids {ids}, "
        f"classes {'equal' if same_class else 'DIFFERENT'}"
    )


def in_order(boxes: ExportBoxes) -> ExportBoxes:
    """Return the boxes by frame and track."""
    return boxes[np.lexsort([boxes.track_id, boxes.frame])]


if __name__ == "__main__":
    main()
