"""What is chosen in an evaluation; what Waymo's definitions fix stands in `metrics`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.errors import BadSetting
from upvl_cli.stage import param


@dataclass(frozen=True)
class EvalParams:
    """Settings of `eval`."""

    iou: tuple[float, ...] = param(
        "a box is right from this 3D IoU with a label on; one score each", least=0.001, most=1
    )
    moving_mps: float = param("an object moves from this speed on", "m/s", least=0.001, most=200)
    right_iou: float = param("to tell why boxes are wrong: right from this 3D IoU on", least=0.001, most=1)
    overlap_iou: float = param("and misplaced above this one, background below", least=0, most=1)
    top_share: float = param(
        "look at that many of the best boxes, as a share of the labels", least=0.001, most=1
    )
    range_edges_m: tuple[float, ...] = param(
        "labels are split by range at these", "m", least=0.1, most=10_000
    )
    speed_edges_mps: tuple[float, ...] = param("and by speed at these", "m/s", least=0.001, most=200)
    point_edges: tuple[int, ...] = param("and by number of LiDAR points at these", least=1, most=10**6)
    flow_reach_m: float = param(
        "flow is scored in a square around the car, with this half side", "m", least=0.1, most=10_000
    )

    def __post_init__(self) -> None:
        for name in ("iou", "range_edges_m", "speed_edges_mps", "point_edges"):
            values = getattr(self, name)
            if not values or list(values) != sorted(set(values)):
                raise BadSetting(f"eval: {name} = {list(values)} must be ascending numbers, and at least one")
