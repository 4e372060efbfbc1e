"""Settings of an evaluation; the constants of the official definitions stand in `metrics`."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadSetting


@dataclass(frozen=True)
class EvalConfig(Config):
    """Settings of `eval`."""

    iou: tuple[float, ...] = setting(
        "3D IoU with a label from which a box is right; each value has a score of its own", ge=0.001, le=1
    )
    moving_mps: float = setting(
        "speed from which an object moves, where only moving objects are scored", "m/s", ge=0.001, le=200
    )
    right_iou: float = setting(
        "3D IoU with a label from which a box is right, in the analysis of errors", ge=0.001, le=1
    )
    overlap_iou: float = setting(
        "3D IoU above which a wrong box is misplaced, else it is on the background, in the analysis of errors",
        ge=0,
        le=1,
    )
    top_share: float = setting(
        "number of the best-scored boxes that the analysis of errors looks at, as a share of the number of labels",
        ge=0.001,
        le=1,
    )
    range_edges_m: tuple[float, ...] = setting(
        "distances from the car that split labels and boxes into groups", "m", ge=0.1, le=10_000
    )
    speed_edges_mps: tuple[float, ...] = setting(
        "speeds that split labels into groups", "m/s", ge=0.001, le=200
    )
    point_edges: tuple[int, ...] = setting(
        "numbers of LiDAR points that split labels into groups", ge=1, le=10**6
    )
    flow_reach_m: float = setting(
        "half side of the square around the car in which flow is scored", "m", ge=0.1, le=10_000
    )

    def __post_init__(self) -> None:
        for name in ("iou", "range_edges_m", "speed_edges_mps", "point_edges"):
            values = getattr(self, name)
            if not values or list(values) != sorted(set(values)):
                raise BadSetting(f"eval: {name} = {list(values)} must be ascending numbers, and at least one")
