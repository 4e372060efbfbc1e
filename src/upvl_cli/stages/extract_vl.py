"""Vision-language features of the points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.visual.config import VisibilityConfig
from upvl_cli.pipeline.stage import Needs, Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import FlowRow, GroundRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.visual.pixel_features import SweepVisibility
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class ExtractVlConfig(Config):
    """Settings of `extract-vl`."""

    images: Literal["all", "none"] = setting(
        "pictures that give features: those of all cameras, or none, so that no point has a feature"
    )
    follow_motion: bool = setting("move points to the time of the picture by their flow before projection")
    visibility: VisibilityConfig = table("Which points of a sweep a camera sees.")


def run(inputs: Inputs, config: ExtractVlConfig) -> Iterator[ExtractVlRow]:
    """Give each point that a camera sees the vision-language feature of its pixel."""
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.perception.visual.pixel_features import CameraRig
    from upvl_cli.perception.visual.pixel_source import PixelSource
    from upvl_cli.runtime.parallel import in_order

    drive, poses = inputs.drive, list(inputs.table("odometry", OdometryRow))
    points_of = compensated_points(drive, poses)
    flows, grounds = inputs.table("flow", FlowRow), inputs.table("ground", GroundRow)
    (pca,) = inputs.table("pca", PcaRow)
    rig = CameraRig(
        drive.cameras if config.images == "all" else (),
        [pose.time_ns for pose in poses],
        [pose.world_from_ego for pose in poses],
        config.visibility,
    )

    def pixels_of(frame: int, camera: str) -> Floats | None:
        return drive.pixels(frame, camera) if isinstance(drive, PixelSource) else None

    def extract(step: int) -> tuple[SweepVisibility, Array]:
        """Return what the cameras see of a frame, and the features of the seen points."""
        frame = poses[step].frame
        flow_mps = flows[frame].flow_mps
        # Without a picture only the number of the points counts: no sweep need be read.
        xyz_m = points_of(frame).xyz_ego_m if rig.cameras else flow_mps
        velocity_mps = flow_mps if config.follow_motion else None
        images = [drive.image(frame, camera.name) for camera in rig.cameras]
        given_px = [pixels_of(frame, camera.name) for camera in rig.cameras]
        seen = rig.visibility(step, xyz_m, ~grounds[frame].is_ground, velocity_mps, images, given_px)
        return seen, seen.features(inputs.model.embed_image, pca.basis)

    steps = [step for step, pose in enumerate(poses) if pose.frame in inputs.window]
    for step, (seen, codes) in zip(steps, in_order(extract, steps), strict=True):
        for reason, items in seen.counts.items():
            inputs.count(reason, items)
        yield ExtractVlRow(inputs.segment, poses[step].frame, seen.state, seen.camera, codes)


STAGE = Stage(
    name="extract-vl",
    run=run,
    config=ExtractVlConfig,
    row=ExtractVlRow,
    reads=("raw", "vlm", "pca", "odometry", "ground", "flow"),
    windowed=True,
    estimates_size=True,
    needs=Needs(gpus=1.0, memory_gib=4.0),
)
