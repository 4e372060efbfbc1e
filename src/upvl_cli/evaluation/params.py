"""What is chosen in an evaluation; what Waymo's definitions fix stands in `metrics`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.errors import BadSetting
from upvl_cli.stage import param


@dataclass(frozen=True)
class EvalParams:
    """Settings of `eval`."""

    iou: tuple[float, ...] = param(
        "a box is right from this 3D IoU with a label on; one score each", above=0, most=1
    )
    moving_mps: float = param("an object moves from this speed on", "m/s", above=0)
    right_iou: float = param("to tell why boxes are wrong: right from this 3D IoU on", above=0, most=1)
    overlap_iou: float = param("and misplaced above this one, background below", least=0, most=1)
    top_share: float = param("look at that many of the best boxes, as a share of the labels", above=0, most=1)
    range_edges_m: tuple[float, ...] = param("labels are split by range at these", "m", above=0)
    speed_edges_mps: tuple[float, ...] = param("and by speed at these", "m/s", above=0)
    point_edges: tuple[int, ...] = param("and by number of LiDAR points at these", least=1)
    flow_reach_m: float = param(
        "flow is scored in a square around the car, with this half side", "m", above=0
    )

    def __post_init__(self) -> None:
        for name in ("iou", "range_edges_m", "speed_edges_mps", "point_edges"):
            values = getattr(self, name)
            if not values or list(values) != sorted(set(values)):
                raise BadSetting(f"eval: {name} = {list(values)} must be ascending numbers, and at least one")
