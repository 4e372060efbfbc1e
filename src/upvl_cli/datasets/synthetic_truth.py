"""The true motion of every point of the made-up drives, for evaluation only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.synthetic import Synthetic
from upvl_cli.types import Array, ParallelArrays, array

# The classes of the Argoverse 2 scene-flow challenge, by kind; anything else is background.
FLOW_CLASSES = ("background", "car", "other vehicles", "pedestrian", "wheeled VRU")
_CLASS_OF = {"Car": 1, "Truck": 2, "Bus": 2, "Pedestrian": 3, "Cyclist": 4}
GROUND = -1


@dataclass(frozen=True)
class FlowTruth(ParallelArrays):
    """What is true of each point of a sweep, in the order of its points.

    Attributes:
        velocity_mps: (n, 3) over the ground, along the ego axes.
        flow_class: (n,) index into `FLOW_CLASSES`; -1 on the ground, which flow is not asked for.
    """

    velocity_mps: Array = array("float64", 3)
    flow_class: Array = array("int64")


class SyntheticFlow:
    """The true flow of the made-up drives."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """Return the true motion of the points of a sweep."""
        drive = Synthetic().open(segment)
        truth = drive.truth(frame)
        of_thing = [_CLASS_OF.get(thing.kind, 0) for thing in drive.scene.things]
        # The number -1 means the ground, and so does the last place of the table.
        return FlowTruth(truth.velocity_mps, np.array([*of_thing, GROUND])[truth.object_index])
