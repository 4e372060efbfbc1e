"""The true motion of every point of the made-up drives, for evaluation only."""

from __future__ import annotations

import numpy as np

from upvl_cli.datasets.flow_truth import FlowTruth
from world.street import Streets

_CLASS_OF = {"Car": 1, "Truck": 2, "Bus": 2, "Pedestrian": 3, "Cyclist": 4}
GROUND = -1


class StreetFlow:
    """The true flow of the made-up drives."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """Return the true motion of the points of a sweep."""
        drive = Streets().open(segment)
        truth = drive.truth(frame)
        of_thing = [_CLASS_OF.get(thing.kind, 0) for thing in drive.scene.things]
        # The number -1 means the ground, and so does the last place of the table.
        return FlowTruth(truth.velocity_mps, np.array([*of_thing, GROUND])[truth.object_index])
