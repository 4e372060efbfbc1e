"""What is chosen in an evaluation; what Waymo's definitions fix stands in `metrics`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadSetting


@dataclass(frozen=True)
class EvalConfig(Config):
    """Settings of `eval`."""

    iou: tuple[float, ...] = setting(
        "a box is right from this 3D IoU with a label on; one score each", ge=0.001, le=1
    )
    moving_mps: float = setting("an object moves from this speed on", "m/s", ge=0.001, le=200)
    right_iou: float = setting("to tell why boxes are wrong: right from this 3D IoU on", ge=0.001, le=1)
    overlap_iou: float = setting("and misplaced above this one, background below", ge=0, le=1)
    top_share: float = setting(
        "look at that many of the best boxes, as a share of the labels", ge=0.001, le=1
    )
    range_edges_m: tuple[float, ...] = setting("labels are split by range at these", "m", ge=0.1, le=10_000)
    speed_edges_mps: tuple[float, ...] = setting("and by speed at these", "m/s", ge=0.001, le=200)
    point_edges: tuple[int, ...] = setting("and by number of LiDAR points at these", ge=1, le=10**6)
    flow_reach_m: float = setting(
        "flow is scored in a square around the car, with this half side", "m", ge=0.1, le=10_000
    )

    def __post_init__(self) -> None:
        for name in ("iou", "range_edges_m", "speed_edges_mps", "point_edges"):
            values = getattr(self, name)
            if not values or list(values) != sorted(set(values)):
                raise BadSetting(f"eval: {name} = {list(values)} must be ascending numbers, and at least one")
