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
        "a point without a feature: has the state of its place when a camera saw that, else it is kept; is kept; "
        "is kept if it moves; is background",
        choices=("remember", "keep", "moving", "drop"),
    )
    no_view_mps: float = param(
        "where that asks whether it moves: from this speed on", "m/s", least=0, most=200
    )


@dataclass(frozen=True)
class MaskRow(Row):
    """State of each point of a sweep, in the order of its points."""

    is_moving: Array = column("bool", "at least as fast as min_speed_mps", per="point")
    background: Array = column(
        "int8",
        "1 background, 0 not, -1 not told: without a feature, and kept by the policy for those",
        per="point",
    )


def run(inputs: Inputs, params: MaskParams) -> Iterator[MaskRow]:
    """Mark the points that move, by speed, and those of the background, by words."""
    import numpy as np

    from upvl_cli.algorithms.masks import UNKNOWN, Background, moving, without_feature
    from upvl_cli.algorithms.remembered import remember
    from upvl_cli.geometry.se3 import apply
    from upvl_cli.parallel import in_order

    (fitted,) = inputs.table("pca")
    features, flows, grounds = (inputs.table(name) for name in ("extract-vl", "flow", "ground"))
    drive, poses = inputs.drive, list(inputs.table("odometry"))
    own = inputs.model.background
    against, eps = (own.against, own.threshold) if params.calibrated else (params.against, params.eps_bg)
    words = inputs.model.embed_text([*params.background, *against])
    rule = Background(fitted.basis, words[: len(params.background)], words[len(params.background) :], eps)

    def told(pose: Any) -> tuple[Array, Array, Array]:
        """State of each point by its own feature, whether it stands still above the ground, and where those are."""
        of = features[pose.frame]
        still = ~grounds[pose.frame].is_ground
        still &= ~moving(flows[pose.frame].flow_mps, min_speed_mps=params.no_view_mps)
        xyz = drive.points(pose.frame).xyz_ego_m[still] if params.no_view == "remember" else np.zeros((0, 3))
        return rule.of(of.state, of.feature), still, apply(pose.world_from_ego, xyz)

    def known(pose: Any) -> tuple[Array, Array]:
        """Places of a sweep whose state is known, and that state."""
        background, still, world_m = told(pose)
        state = background[still][: len(world_m)]
        return world_m[state != UNKNOWN], state[state != UNKNOWN] == 1

    memory = remember(in_order(known, poses))
    for pose in poses:
        flow_mps = flows[pose.frame].flow_mps
        is_moving = moving(flow_mps, min_speed_mps=params.min_speed_mps)
        background, still, world_m = told(pose)
        if params.no_view == "remember":
            unseen = background[still] == UNKNOWN
            background[np.flatnonzero(still)[unseen]] = memory.of(world_m[unseen])
        fast = moving(flow_mps, min_speed_mps=params.no_view_mps)
        background = without_feature(background, fast, policy=params.no_view)
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
)
