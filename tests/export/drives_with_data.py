"""The drive on the slope with points and pictures: as many points in each box as its label says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from export.labelled_drives import labelled_drive
from upvl_cli.export.drive import ExportDrive
from upvl_cli.types import Camera, Frame, Image, Points


@dataclass(frozen=True)
class SlopeDrive:
    """A drive whose sweeps and pictures are made when they are asked for; the camera "left" misses one picture."""

    labelled: ExportDrive
    skipped: Mapping[str, int] = field(default_factory=dict)
    ground_z_m: float = 0.0
    files: tuple[Path, ...] = ()

    @property
    def name(self) -> str:
        return self.labelled.name

    @property
    def frames(self) -> tuple[Frame, ...]:
        return self.labelled.frames

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return self.labelled.cameras

    @property
    def world_from_ego(self) -> np.ndarray:
        return self.labelled.world_from_ego

    def points(self, frame: int) -> Points:
        """The centre of each box, spread over a tenth of a metre, and one point far from all."""
        boxes = self.labelled.boxes[self.labelled.boxes.frame == frame]
        parts = [np.array([[60.0, 0.0, 0.0]])]
        for center, count in zip(boxes.center_m, boxes.num_points, strict=True):
            parts.append(center + np.linspace(-0.05, 0.05, count)[:, None])
        xyz = np.concatenate(parts)
        n = len(xyz)
        return Points(xyz, np.linspace(0, 1, n), np.zeros(n), np.zeros(n), np.zeros(n))

    def image(self, frame: int, camera: str) -> Image | None:
        if camera == "left" and frame == self.frames[1].index:
            return None
        rgb = np.full((480, 640, 3), 10 * frame, np.uint8)
        return Image(rgb, next(one.time_ns for one in self.frames if one.index == frame))


def drive_with_data(name: str = "bend-1", frames: int = 6) -> ExportDrive:
    drive = labelled_drive(name, frames)
    return replace(drive, source=SlopeDrive(drive))
