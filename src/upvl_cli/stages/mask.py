"""Which points move, and which are background."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.background.config import PlaceMemoryConfig, ShapeClassifierConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, GroundRow, MaskRow, OdometryRow, PcaRow

if TYPE_CHECKING:
    from upvl_cli.perception.background.masks import BackgroundClassifier
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Model


@dataclass(frozen=True)
class MaskConfig(Config):
    """Settings of `mask`."""

    min_speed_mps: float = setting(
        "lowest speed of a point that counts as moving: eps_sf of UP-VL", "m/s", ge=0, le=200
    )
    background: tuple[str, ...] = setting("words for background: C_bg of UP-VL")
    use_model_rule: bool = setting(
        "use the background rule of the vision-language model, not eps_bg and against"
    )
    eps_bg: float = setting("lowest score of a background point on the scale of the model", ge=-2, le=2)
    against: tuple[str, ...] = setting(
        "words for other things: the score is the highest cosine with a background word less the highest with "
        "one of these; none in UP-VL"
    )
    moving_is_foreground: bool = setting(
        "a point at moving_mps or faster is never background by words or by place, because background is static"
    )
    moving_mps: float = setting(
        "lowest speed of a moving point for moving_is_foreground, unseen_policy and the counts",
        "m/s",
        ge=0,
        le=200,
    )
    unseen_policy: Literal["shape_classifier", "place_memory", "keep", "moving", "drop"] = setting(
        "state of a point without a feature: that of its place at other times, else by its shape "
        "(shape_classifier); of its place, else unknown (place_memory); unknown, so that it is kept (keep); "
        "unknown if it moves, else background (moving); background (drop)"
    )
    place_memory: PlaceMemoryConfig = table("The background state of a place, from the sweeps that saw it.")
    shape_classifier: ShapeClassifierConfig = table("The background state of a point, by its LiDAR shape.")


def background_classifier(pca: PcaRow, model: Model, config: MaskConfig) -> BackgroundClassifier:
    """Return the classifier of a model's features as background or not.

    Args:
        pca: The reduced space of the features.
        model: The vision-language model.
        config: Words and threshold.
    """
    from upvl_cli.perception.background.masks import BackgroundClassifier

    against, threshold = config.against, config.eps_bg
    if config.use_model_rule:
        against, threshold = model.background.against, model.background.threshold
    words, count = model.embed_text([*config.background, *against]), len(config.background)
    return BackgroundClassifier(pca.basis, words[:count], words[count:], threshold)


def run(inputs: Inputs, config: MaskConfig) -> Iterator[MaskRow]:
    """Mark the points that move, by speed, and those of the background, by words."""
    import numpy as np

    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.background.completion import BackgroundCompletion, SweepBackground
    from upvl_cli.perception.background.masks import apply_motion_and_policy, moving
    from upvl_cli.perception.background.shape_classifier import compute_shape_features
    from upvl_cli.runtime.parallel import in_order

    (pca,) = inputs.table("pca", PcaRow)
    features, flows = inputs.table("extract-vl", ExtractVlRow), inputs.table("flow", FlowRow)
    grounds = inputs.table("ground", GroundRow)
    drive, poses = inputs.drive, list(inputs.table("odometry", OdometryRow))
    classifier = background_classifier(pca, inputs.model, config)

    def seen_background(pose: OdometryRow) -> Array:
        """Return the state of each point by words."""
        return classifier.classify(features[pose.frame].state, features[pose.frame].feature)

    def is_moving(pose: OdometryRow) -> Array:
        """Return whether each point moves as the rules for moving points ask for."""
        return moving(flows[pose.frame].flow_mps, min_speed_mps=config.moving_mps)

    def sweep_background(pose: OdometryRow) -> SweepBackground:
        """Return what the cameras tell of the points above the ground."""
        ground = grounds[pose.frame]
        above = ~ground.is_ground
        xyz_m = drive.points(pose.frame).xyz_ego_m[above].astype(np.float64)
        shape_features = None
        if config.unseen_policy == "shape_classifier":
            shape_features = compute_shape_features(xyz_m, ground.height_m[above], config.shape_classifier)
        is_foreground = is_moving(pose)[above] & config.moving_is_foreground
        world_xyz_m = apply(pose.world_from_ego, xyz_m)
        return SweepBackground(seen_background(pose)[above], is_foreground, world_xyz_m, shape_features)

    completes = config.unseen_policy in ("shape_classifier", "place_memory")
    sweeps = in_order(sweep_background, poses if completes else ())
    completion = BackgroundCompletion(sweeps, config.place_memory, config.shape_classifier)

    def final_background(pose: OdometryRow) -> Array:
        """Return the state of each point."""
        background = seen_background(pose)
        if completes:
            background[~grounds[pose.frame].is_ground] = completion.complete(sweep_background(pose))
        return apply_motion_and_policy(
            background,
            is_moving(pose),
            policy=config.unseen_policy,
            moving_is_foreground=config.moving_is_foreground,
        )

    for pose, background in zip(poses, in_order(final_background, poses), strict=True):
        above_eps_sf = moving(flows[pose.frame].flow_mps, min_speed_mps=config.min_speed_mps)
        moves = is_moving(pose)
        inputs.count("points moving", moves.sum())
        inputs.count("points still", (~moves).sum())
        inputs.count("points slower than min_speed_mps, left out", (~above_eps_sf).sum())
        inputs.count("points background", (background == 1).sum())
        inputs.count("points not background", (background == 0).sum())
        inputs.count("points without a feature, kept", (background < 0).sum())
        yield MaskRow(inputs.segment, pose.frame, above_eps_sf, background)


STAGE = Stage(
    name="mask",
    run=run,
    config=MaskConfig,
    row=MaskRow,
    reads=("raw", "vlm", "odometry", "ground", "pca", "flow", "extract-vl"),
    version=4,
)
