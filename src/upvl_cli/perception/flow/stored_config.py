"""Settings of flow from files; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from upvl_cli.config.base import Config, setting
from upvl_cli.runtime.array_files import frame_files


@dataclass(frozen=True)
class StoredFlowConfig(Config):
    """Flow that another program has written: `ROOT/SEGMENT/FRAME.npy`, an (n, 3) array in the order of the points."""

    root: str = setting(
        "folder of the flow, seen from where upvl is run; its files are ROOT/SEGMENT/000000.npy"
    )
    unit: Literal["m/s", "m/interval"] = setting(
        "unit of the numbers in the files",
        effects={
            "m/s": "velocities, forward in time in every frame",
            "m/interval": "displacements until the next sweep; of the last frame until the one before",
        },
    )
    ego_motion: Literal["removed", "included"] = setting(
        "whether the numbers have the motion of the ego car in them",
        effects={
            "removed": "they are of motion over the ground, in the ego axes of the frame; what stands has 0",
            "included": "point + displacement is the point in the ego axes of the other sweep",
        },
    )
    missing: Literal["error", "zero"] = setting(
        "what a frame without a file gets",
        effects={"error": "the stage stops", "zero": "no motion, and the frame is counted"},
    )

    def files(self, segment: str) -> tuple[Path, ...]:
        """Return the files of a drive: their content is part of the stamp."""
        return frame_files(self.folder, segment) if self.root else ()

    @property
    def folder(self) -> Path:
        """The folder that `root` names."""
        return Path(self.root).expanduser()
