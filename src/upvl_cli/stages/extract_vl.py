"""Vision-language features of the points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, GroundRow, OdometryRow, PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class ExtractVlConfig(Config):
    """Settings of `extract-vl`."""

    images: Literal["all", "none"] = setting(
        "which pictures are looked at; without any no point has a feature"
    )
    border_px: float = setting(
        "nearer than this to the border of a picture a point is out of view", "px", ge=0, le=1000
    )
    gap_deg: float = setting(
        "points of one surface are no farther apart, as a camera sees them", "degrees", ge=0.01, le=20
    )
    closer_m: float = setting("what hides a point is closer by this,", "m", ge=0, le=100)
    closer_share: float = setting("and by this share of the point's depth", ge=0, le=1)
    glass_m: float = setting(
        "what stands hides the ground far behind it up to this much above its points: glass returns none",
        "m",
        ge=0,
        le=10,
    )
    follow_motion: bool = setting("bring moving points to the time of the picture by their flow")


def run(inputs: Inputs, config: ExtractVlConfig) -> Iterator[ExtractVlRow]:
    """Give each point that a camera sees the vision-language feature of its pixel."""
    from upvl_cli.perception.visual.pixel_features import Look, Sight
    from upvl_cli.runtime.parallel import in_order

    drive = inputs.drive
    poses, flows, grounds = (
        list(inputs.table("odometry", OdometryRow)),
        inputs.table("flow", FlowRow),
        inputs.table("ground", GroundRow),
    )
    (fitted,) = inputs.table("pca", PcaRow)
    look = Look(
        drive.cameras if config.images == "all" else (),
        [pose.time_ns for pose in poses],
        [pose.world_from_ego for pose in poses],
        border_px=config.border_px,
        gap_deg=config.gap_deg,
        closer_m=config.closer_m,
        closer_share=config.closer_share,
        glass_m=config.glass_m,
    )

    def seen_in(step: int) -> tuple[Sight, Array]:
        """What the cameras see of a frame, and the features of what they see."""
        frame = poses[step].frame
        flow = flows[frame].flow_mps
        # Without a picture only the number of the points counts: no sweep need be read.
        xyz = drive.points(frame).xyz_ego_m if look.cameras else flow
        motion = flow if config.follow_motion else None
        images = [drive.image(frame, camera.name) for camera in look.cameras]
        seen = look.sight(step, xyz, ~grounds[frame].is_ground, motion, images)
        return seen, seen.features(inputs.model.embed_image, fitted.basis)

    for step, (seen, codes) in enumerate(in_order(seen_in, range(len(poses)))):
        for reason, items in seen.counts.items():
            inputs.count(reason, items)
        yield ExtractVlRow(inputs.segment, poses[step].frame, seen.state, seen.camera, codes)


STAGE = Stage(
    name="extract-vl",
    run=run,
    config=ExtractVlConfig,
    row=ExtractVlRow,
    reads=("raw", "vlm", "pca", "odometry", "ground", "flow"),
    estimates_size=True,
)
