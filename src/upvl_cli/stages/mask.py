"""Which points move, and which are background."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, GroundRow, MaskRow, OdometryRow, PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class MaskConfig(Config):
    """Settings of `mask`."""

    min_speed_mps: float = setting(
        "a point moves from this speed on: the paper's eps_sf", "m/s", ge=0, le=200
    )
    background: tuple[str, ...] = setting("words for background: the paper's C_bg")
    calibrated: bool = setting("take the model's own rule, and not the two settings that follow")
    eps_bg: float = setting("a point this much like a background word is background", ge=-2, le=2)
    against: tuple[str, ...] = setting("words that background is compared with; none in the paper")
    no_view: Literal["alike", "remember", "keep", "moving", "drop"] = setting(
        "a point without a feature: has the state of its place when a camera saw that, else of what looks like it "
        "to the LiDAR; of its place, else it is kept; is kept; is kept if it moves; is background",
    )
    moving_mps: float = setting(
        "from this speed on a point is no background, whatever words say", "m/s", ge=0, le=200
    )


def run(inputs: Inputs, config: MaskConfig) -> Iterator[MaskRow]:
    """Mark the points that move, by speed, and those of the background, by words."""
    import numpy as np

    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.background.completion import Sighting, Unseen
    from upvl_cli.perception.background.masks import Background, moving, settled
    from upvl_cli.perception.background.shape_classifier import shapes
    from upvl_cli.runtime.parallel import in_order

    (fitted,) = inputs.table("pca", PcaRow)
    features, flows = inputs.table("extract-vl", ExtractVlRow), inputs.table("flow", FlowRow)
    grounds = inputs.table("ground", GroundRow)
    drive, poses = inputs.drive, list(inputs.table("odometry", OdometryRow))
    own = inputs.model.background
    against, eps = (own.against, own.threshold) if config.calibrated else (config.against, config.eps_bg)
    words = inputs.model.embed_text([*config.background, *against])
    rule = Background(fitted.basis, words[: len(config.background)], words[len(config.background) :], eps)

    def sighting(pose: OdometryRow) -> Sighting:
        """What the cameras tell of the points above the ground."""
        of, above = features[pose.frame], ~grounds[pose.frame].is_ground
        xyz_m = drive.points(pose.frame).xyz_ego_m[above].astype(np.float64)
        return Sighting(
            rule.of(of.state, of.feature)[above],
            moving(flows[pose.frame].flow_mps[above], min_speed_mps=config.moving_mps),
            apply(pose.world_from_ego, xyz_m),
            shapes(xyz_m, grounds[pose.frame].height_m[above]) if config.no_view == "alike" else None,
        )

    learns = config.no_view in ("alike", "remember")
    unseen = Unseen(in_order(sighting, poses if learns else ()))

    def state(pose: OdometryRow) -> Array:
        """State of each point."""
        of = features[pose.frame]
        background = rule.of(of.state, of.feature)
        if learns:
            background[~grounds[pose.frame].is_ground] = unseen.of(sighting(pose))
        fast = moving(flows[pose.frame].flow_mps, min_speed_mps=config.moving_mps)
        return settled(background, fast, policy=config.no_view)

    for pose, background in zip(poses, in_order(state, poses), strict=True):
        is_moving = moving(flows[pose.frame].flow_mps, min_speed_mps=config.min_speed_mps)
        inputs.count("points moving", is_moving.sum())
        inputs.count("points still", (~is_moving).sum())
        inputs.count("points background", (background == 1).sum())
        inputs.count("points not background", (background == 0).sum())
        inputs.count("points without a feature, kept", (background < 0).sum())
        yield MaskRow(inputs.segment, pose.frame, is_moving, background)


STAGE = Stage(
    name="mask",
    run=run,
    config=MaskConfig,
    row=MaskRow,
    reads=("raw", "vlm", "odometry", "ground", "pca", "flow", "extract-vl"),
    version=3,
)
