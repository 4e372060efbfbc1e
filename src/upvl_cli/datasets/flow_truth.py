"""True motion of LiDAR points, where a dataset knows it; for evaluation only."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.types import Array, ParallelArrays, array

# The classes of the Argoverse 2 scene-flow challenge; anything else is background.
FLOW_CLASSES = ("background", "car", "other vehicles", "pedestrian", "wheeled VRU")


@dataclass(frozen=True)
class FlowTruth(ParallelArrays):
    """What is true of each point of a sweep, in the order of its points.

    Attributes:
        velocity_mps: (n, 3) over the ground, along the ego axes.
        flow_class: (n,) index into `FLOW_CLASSES`; -1 on the ground, which flow is not asked for.
    """

    velocity_mps: Array = array("float64", 3)
    flow_class: Array = array("int64")
