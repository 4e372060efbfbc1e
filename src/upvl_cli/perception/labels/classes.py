"""Classes of labels, with the numbers of the Waymo Open Dataset."""

from __future__ import annotations

from typing import Final

OTHER: Final = 0
VEHICLE: Final = 1
PEDESTRIAN: Final = 2
CYCLIST: Final = 4
CLASS_NAMES: Final = {VEHICLE: "vehicle", PEDESTRIAN: "pedestrian", CYCLIST: "cyclist", OTHER: "other"}
UNKNOWN: Final = "unknown"  # the class of what no camera saw
