"""Auto labels that a person has corrected, as labels to score against."""

from __future__ import annotations

import numpy as np

from upvl_cli.datasets.shared.tracks import count_points
from upvl_cli.errors import BadInput, NotMade
from upvl_cli.export.corrections import corrected_segments, reviewed_frames
from upvl_cli.export.drive import labels_of
from upvl_cli.export.gather import drive_with_boxes
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Bools, Ints, Labels


class CorrectedLabels:
    """The auto labels of the drives that a person has been through, with the corrections over them."""

    def __init__(self, workspace: Workspace) -> None:
        """Take the workspace that holds both."""
        self._workspace = workspace

    def frames(self, segment: str) -> Ints:
        """Return the frames that a person has seen; raises `BadInput` where there are none."""
        if segment not in corrected_segments(self._workspace):
            raise BadInput(f"{segment} has no hand corrections; run: upvl import-labels")
        return reviewed_frames(self._workspace, segment)

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """Return (n,) True: a person sees the whole sweep."""
        return np.ones(len(xyz_ego_m), dtype=np.bool_)

    def labels(self, segment: str) -> Labels:
        """Return all boxes of a drive; raises `BadInput` where nobody has corrected it."""
        self.frames(segment)
        try:
            drive = drive_with_boxes(self._workspace, segment, "corrected", "class")
        except NotMade as error:
            raise BadInput(str(error)) from None
        return count_points(labels_of(drive.boxes), self._workspace.drive(segment))
