"""Which points move, and which are background."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class MaskParams:
    """Settings of `mask`."""

    min_speed_mps: float = param(
        "a point moves from this speed on: the paper's eps_sf", "m/s", least=0, most=200
    )
    background: tuple[str, ...] = param("words for background: the paper's C_bg")
    calibrated: bool = param("take the model's own rule, and not the two settings that follow")
    eps_bg: float = param("a point this much like a background word is background", least=-2, most=2)
    against: tuple[str, ...] = param("words that background is compared with; none in the paper")
    no_view: str = param(
        "a point without a feature: has the state of its place when a camera saw that, else of what looks like it "
        "to the LiDAR; of its place, else it is kept; is kept; is kept if it moves; is background",
        choices=("alike", "remember", "keep", "moving", "drop"),
    )
    moving_mps: float = param(
        "from this speed on a point is no background, whatever words say", "m/s", least=0, most=200
    )


@dataclass(frozen=True)
class MaskRow(Row):
    """State of each point of a sweep, in the order of its points."""

    is_moving: Array = column("bool", "at least as fast as min_speed_mps", per="point")
    background: Array = column(
        "int8",
        "1 background, 0 not, -1 not told: it moves, or has no feature and is kept by the policy for those",
        per="point",
    )


def run(inputs: Inputs, params: MaskParams) -> Iterator[MaskRow]:
    """Mark the points that move, by speed, and those of the background, by words."""
    import numpy as np

    from upvl_cli.algorithms.alike import shapes
    from upvl_cli.algorithms.masks import Background, moving, settled
    from upvl_cli.algorithms.unseen import Sighting, Unseen
    from upvl_cli.geometry.se3 import apply
    from upvl_cli.parallel import in_order

    (fitted,) = inputs.table("pca")
    features, flows, grounds = (inputs.table(name) for name in ("extract-vl", "flow", "ground"))
    drive, poses = inputs.drive, list(inputs.table("odometry"))
    own = inputs.model.background
    against, eps = (own.against, own.threshold) if params.calibrated else (params.against, params.eps_bg)
    words = inputs.model.embed_text([*params.background, *against])
    rule = Background(fitted.basis, words[: len(params.background)], words[len(params.background) :], eps)

    def sighting(pose: Any) -> Sighting:
        """What the cameras tell of the points above the ground."""
        of, above = features[pose.frame], ~grounds[pose.frame].is_ground
        xyz_m = drive.points(pose.frame).xyz_ego_m[above].astype(np.float64)
        return Sighting(
            rule.of(of.state, of.feature)[above],
            moving(flows[pose.frame].flow_mps[above], min_speed_mps=params.moving_mps),
            apply(pose.world_from_ego, xyz_m),
            shapes(xyz_m, grounds[pose.frame].height_m[above]) if params.no_view == "alike" else None,
        )

    learns = params.no_view in ("alike", "remember")
    unseen = Unseen(in_order(sighting, poses if learns else ()))

    def state(pose: Any) -> Array:
        """State of each point."""
        of = features[pose.frame]
        background = rule.of(of.state, of.feature)
        if learns:
            background[~grounds[pose.frame].is_ground] = unseen.of(sighting(pose))
        fast = moving(flows[pose.frame].flow_mps, min_speed_mps=params.moving_mps)
        return settled(background, fast, policy=params.no_view)

    for pose, background in zip(poses, in_order(state, poses), strict=True):
        is_moving = moving(flows[pose.frame].flow_mps, min_speed_mps=params.min_speed_mps)
        inputs.count("points moving", is_moving.sum())
        inputs.count("points still", (~is_moving).sum())
        inputs.count("points background", (background == 1).sum())
        inputs.count("points not background", (background == 0).sum())
        inputs.count("points without a feature, kept", (background < 0).sum())
        yield MaskRow(inputs.segment, pose.frame, is_moving, background)


STAGE = Stage(
    name="mask",
    run=run,
    params=MaskParams,
    row=MaskRow,
    reads=("raw", "vlm", "odometry", "ground", "pca", "flow", "extract-vl"),
    version=3,
)
