"""Vision-language features of the points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class ExtractVlParams:
    """Settings of `extract-vl`."""

    images: str = param(
        "which pictures are looked at; without any no point has a feature", choices=("all", "none")
    )
    border_px: float = param(
        "nearer than this to the border of a picture a point is out of view", "px", least=0, most=1000
    )
    gap_deg: float = param(
        "points of one surface are no farther apart, as a camera sees them", "degrees", least=0.01, most=20
    )
    closer_m: float = param("what hides a point is closer by this,", "m", least=0, most=100)
    closer_share: float = param("and by this share of the point's depth", least=0, most=1)
    glass_m: float = param(
        "what stands hides the ground far behind it up to this much above its points: glass returns none",
        "m",
        least=0,
        most=10,
    )
    follow_motion: bool = param("bring moving points to the time of the picture by their flow")


@dataclass(frozen=True)
class ExtractVlRow(Row):
    """Features of the points of one sweep."""

    state: Array = column("int8", "0 seen, 1 occluded, 2 no view: outside of all pictures", per="point")
    camera: Array = column(
        "int8", "place of the camera that sees it best among the drive's cameras, -1 for none", per="point"
    )
    feature: Array = column(
        "int8",
        "values of the seen points, in the order of the points, to be scaled by pca's steps",
        per="seen point",
        shape=(64,),
    )


def run(inputs: Inputs, params: ExtractVlParams) -> Iterator[ExtractVlRow]:
    """Give each point that a camera sees the vision-language feature of its pixel."""
    from upvl_cli.algorithms.pixel_features import Look, Sight
    from upvl_cli.parallel import in_order

    drive = inputs.drive
    poses, flows, grounds = list(inputs.table("odometry")), inputs.table("flow"), inputs.table("ground")
    (fitted,) = inputs.table("pca")
    look = Look(
        drive.cameras if params.images == "all" else (),
        [pose.time_ns for pose in poses],
        [pose.world_from_ego for pose in poses],
        border_px=params.border_px,
        gap_deg=params.gap_deg,
        closer_m=params.closer_m,
        closer_share=params.closer_share,
        glass_m=params.glass_m,
    )

    def seen_in(step: int) -> tuple[Sight, Array]:
        """What the cameras see of a frame, and the features of what they see."""
        frame = poses[step].frame
        flow = flows[frame].flow_mps
        # Without a picture only the number of the points counts: no sweep need be read.
        xyz = drive.points(frame).xyz_ego_m if look.cameras else flow
        motion = flow if params.follow_motion else None
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
    params=ExtractVlParams,
    row=ExtractVlRow,
    reads=("raw", "vlm", "pca", "odometry", "ground", "flow"),
    large=True,
)
