"""The points of a frame as a table: places, intensity, and what upvl knows of each point."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.export.point_tables import COLUMNS_OF
from upvl_cli.export.tool_files import boxes_of_frame
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.geometry.se3 import apply, rotate
from upvl_cli.types import Array, Ints

NONE = -1  # no word, no track, no class
# The fields that a table gives, by its stage.
_FIELDS = {
    "ground": "height and is_ground",
    "flow": "flow (vx, vy, vz)",
    "mask": "is_moving",
    "semantics": "word",
}


@dataclass
class Numbering:
    """Numbers of names, in the order in which they come."""

    number_of: dict[str, int] = field(default_factory=dict)

    def numbers(self, names: Iterable[str]) -> Ints:
        """Return the number of each name; new ones follow the last."""
        return np.array(
            [self.number_of.setdefault(name, len(self.number_of)) for name in names], dtype=np.int64
        )

    def write(self, path: Path) -> None:
        """Write a table of number and name."""
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("number", "name"))
            table.writerows((number, name) for name, number in self.number_of.items())


@dataclass(frozen=True)
class PointFields:
    """Makes the tables of points of an export.

    Attributes:
        losses: Counts what a drive has not.
        world_axes: Whether places and flow are along the axes of the world.
        words: Numbers of the words of points.
        classes: Numbers of the classes of labels.
    """

    losses: Losses
    world_axes: bool
    words: Numbering = field(default_factory=Numbering)
    classes: Numbering = field(default_factory=Numbering)

    def can_read(self, drive: ExportDrive) -> bool:
        """Return whether a drive has points; what it lacks is counted."""
        if drive.source is None:
            self.losses["drives whose files cannot be read: no points of them are written"] += 1
            return False
        first = drive.frames[0].index if drive.frames else None
        made = drive.point_columns(first) if drive.point_columns and first is not None else {}
        for stage, columns in COLUMNS_OF.items():
            if not all(name in made for name in columns):
                reason = f"drives without the table {stage}: their points have no {_FIELDS[stage]}"
                self.losses[f"{reason}; make it with: upvl {stage}"] += 1
        return True

    def columns(self, drive: ExportDrive, place: int) -> dict[str, Array]:
        """Return (n,) arrays by the name of the field, for the points of the frame at a place of the drive.

        Raises:
            BadInput: A table is of another sweep.
        """
        assert drive.source is not None
        frame = drive.frames[place].index
        points = drive.source.points(frame)
        known = dict(drive.point_columns(frame)) if drive.point_columns else {}
        names = known.pop("class_name", np.zeros(0, dtype=str))
        for name, values in known.items():
            if len(values) != len(points):
                raise BadInput(
                    f"{name} of frame {frame} of {drive.name} has {len(values)} values for {len(points)} points; "
                    "make the tables again: upvl autolabel"
                )
        pose = drive.world_from_ego[place]
        xyz = apply(pose, points.xyz_ego_m) if self.world_axes else points.xyz_ego_m
        fields = dict(zip("xyz", xyz.T, strict=True)) | {"intensity": points.intensity.astype(np.float32)}
        fields |= self._known_fields(known, names, pose)
        return fields | self._label_fields(drive, frame, points.xyz_ego_m)

    def _known_fields(self, known: Mapping[str, Array], names: Array, pose: Array) -> dict[str, Array]:
        fields: dict[str, Array] = {}
        if "height_m" in known:
            fields |= {
                "height": known["height_m"].astype(np.float32),
                "is_ground": known["is_ground"].astype(np.uint8),
            }
        if "flow_mps" in known:
            flow = known["flow_mps"].astype(np.float32)
            along = rotate(pose, flow).astype(np.float32) if self.world_axes else flow
            fields |= dict(zip(("vx", "vy", "vz"), along.T, strict=True))
        if "is_moving" in known:
            fields["is_moving"] = known["is_moving"].astype(np.uint8)
        if "class_index" in known:
            numbers = np.append(self.words.numbers(map(str, names)), NONE)
            fields["word"] = numbers[known["class_index"]].astype(np.int16)
        return fields

    def _label_fields(self, drive: ExportDrive, frame: int, xyz_ego_m: Array) -> dict[str, Array]:
        """Return track and class of the box that holds each point; the surest one where there are several."""
        boxes = boxes_of_frame(drive, frame)
        boxes = boxes[np.argsort(boxes.score, kind="stable")]
        box, point = pairs_inside(xyz_ego_m, boxes, margin_m=0.0)
        track = np.full(len(xyz_ego_m), NONE, dtype=np.int64)
        number = np.full(len(xyz_ego_m), NONE, dtype=np.int16)
        classes = self.classes.numbers(map(str, boxes.class_name))
        for i in range(len(boxes)):  # ascending score: a later box is surer
            inside = point[box == i]
            track[inside], number[inside] = boxes.track_id[i], classes[i]
        fits = np.abs(track).max(initial=0) < 2**31
        return {"track_id": track.astype(np.int32 if fits else np.float64), "class": number}

    def write_names(self, folder: Path) -> None:
        """Write what the numbers of words and classes mean."""
        self.words.write(folder / "words.csv")
        self.classes.write(folder / "classes.csv")
