"""Which points move, and which are background."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.background.config import PlaceMemoryConfig, ShapeClassifierConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import FlowRow, GroundRow, MaskRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.background.completion import BackgroundCompletion, SweepBackground
    from upvl_cli.perception.background.masks import BackgroundClassifier
    from upvl_cli.pipeline.stage import Inputs, Rows
    from upvl_cli.types import Array, Bools, Model, Points


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
    window_s: float = setting(
        "length of the windows of time whose places and shapes complete the points without a feature; those of a "
        "longer drive overlap by half",
        "s",
        ge=1,
        le=3600,
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
    from upvl_cli.perception.background.masks import apply_motion_and_policy, moving
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    (pca,) = inputs.table("pca", PcaRow)
    sweeps = _Sweeps(
        compensated_points(inputs.drive, inputs.table("odometry", OdometryRow)),
        inputs.table("flow", FlowRow),
        inputs.table("ground", GroundRow),
        inputs.table("extract-vl", ExtractVlRow),
        background_classifier(pca, inputs.model, config),
        config,
    )

    def masks(part: tuple[OdometryRow, BackgroundCompletion | None]) -> tuple[int, Bools, Bools, Array]:
        """Return the number of a frame, whether each of its points moves and is fast enough, and its state."""
        pose, completion = part
        flow_mps, background = sweeps.flows[pose.frame].flow_mps, sweeps.seen_background(pose)
        if completion is not None:
            above = ~sweeps.grounds[pose.frame].is_ground
            background[above] = completion.complete(sweeps.background_above_ground(pose))
        moves = moving(flow_mps, min_speed_mps=config.moving_mps)
        background = apply_motion_and_policy(
            background,
            moves,
            policy=config.unseen_policy,
            moving_is_foreground=config.moving_is_foreground,
        )
        return pose.frame, moves, moving(flow_mps, min_speed_mps=config.min_speed_mps), background

    for frame, moves, above_eps_sf, background in in_order(masks, _parts(inputs, sweeps, config)):
        inputs.count("points moving", moves.sum())
        inputs.count("points still", (~moves).sum())
        inputs.count("points slower than min_speed_mps, left out", (~above_eps_sf).sum())
        inputs.count("points background", (background == 1).sum())
        inputs.count("points not background", (background == 0).sum())
        inputs.count("points without a feature, kept", (background < 0).sum())
        yield MaskRow(inputs.segment, frame, above_eps_sf, background)


@dataclass(frozen=True)
class _Sweeps:
    """The sweeps of a drive, and what is known of their points."""

    points_of: Callable[[int], Points]
    flows: Rows[FlowRow]
    grounds: Rows[GroundRow]
    features: Rows[ExtractVlRow]
    classifier: BackgroundClassifier
    config: MaskConfig

    def seen_background(self, pose: OdometryRow) -> Array:
        """Return the state of each point by words."""
        row = self.features[pose.frame]
        return self.classifier.classify(row.state, row.feature)

    def background_above_ground(self, pose: OdometryRow) -> SweepBackground:
        """Return what the cameras tell of the points above the ground."""
        import numpy as np

        from upvl_cli.geometry.se3 import apply
        from upvl_cli.perception.background.completion import SweepBackground
        from upvl_cli.perception.background.masks import moving
        from upvl_cli.perception.background.shape_classifier import compute_shape_features

        ground, config = self.grounds[pose.frame], self.config
        above = ~ground.is_ground
        xyz_m = self.points_of(pose.frame).xyz_ego_m[above].astype(np.float64)
        shape_features = None
        if config.unseen_policy == "shape_classifier":
            shape_features = compute_shape_features(xyz_m, ground.height_m[above], config.shape_classifier)
        flow_mps = self.flows[pose.frame].flow_mps[above]
        is_foreground = moving(flow_mps, min_speed_mps=config.moving_mps) & config.moving_is_foreground
        world_xyz_m = apply(pose.world_from_ego, xyz_m)
        return SweepBackground(self.seen_background(pose)[above], is_foreground, world_xyz_m, shape_features)


def _parts(
    inputs: Inputs, sweeps: _Sweeps, config: MaskConfig
) -> Iterator[tuple[OdometryRow, BackgroundCompletion | None]]:
    """Yield each frame with what completes it: the places and shapes of the seconds around it."""
    import numpy as np

    from upvl_cli.perception.background.completion import CompletionEvidence
    from upvl_cli.perception.windows import fits_by_window
    from upvl_cli.runtime.parallel import in_order

    poses = inputs.table("odometry", OdometryRow)
    if config.unseen_policy not in ("shape_classifier", "place_memory"):
        yield from ((pose, None) for pose in poses)
        return
    time_ns = [pose.time_ns for pose in poses]
    time_s = np.array([(time - time_ns[0]) * 1e-9 for time in time_ns])
    seen = in_order(sweeps.background_above_ground, poses)
    frames = iter(poses)
    for part, completion in fits_by_window(
        time_s,
        seen,
        config.window_s,
        lambda: CompletionEvidence(config.place_memory, config.shape_classifier),
    ):
        yield from ((next(frames), completion) for _ in part)


STAGE = Stage(
    name="mask",
    run=run,
    config=MaskConfig,
    row=MaskRow,
    reads=("raw", "vlm", "odometry", "ground", "pca", "flow", "extract-vl"),
    version=5,
)
