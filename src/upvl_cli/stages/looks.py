"""Looks at whole tracks in the best pictures of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, table
from upvl_cli.perception.labels.config import LookChoiceConfig, LookCropConfig
from upvl_cli.pipeline.stage import Needs, Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, LooksRow, PcaRow
from upvl_cli.stages.rows import AmodalRow, MaskRow, OdometryRow

if TYPE_CHECKING:
    from collections.abc import Callable

    from upvl_cli.perception.labels.looks import TrackLooks
    from upvl_cli.perception.labels.track_views import FrameObjects, ObjectLook
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class LooksConfig(Config):
    """Settings of `looks`."""

    choice: LookChoiceConfig = table("Which pictures of a track are looked at.")
    crop: LookCropConfig = table("The part of a picture that is looked at.")


def run(inputs: Inputs, config: LooksConfig) -> Iterator[LooksRow]:
    """Look at each track in the pictures that show it best, and give its labels one mean feature of these looks.

    Best is what is large in the picture and little occluded; the part around the object is given to the model alone,
    with more pixels than it has of it in the whole picture.
    """
    looks = _look(inputs, config)
    for row in inputs.table("nms", AmodalRow):
        num_looks, feature = looks.of(row.track_id.tolist())
        inputs.count("labels of tracks with looks", (num_looks > 0).sum())
        inputs.count("labels of tracks without looks", (num_looks == 0).sum())
        yield LooksRow(inputs.segment, row.frame, row.track_id, num_looks, feature)


def _look(inputs: Inputs, config: LooksConfig) -> TrackLooks:
    """Choose by points alone; then open each picture that shows a chosen object, once."""
    import numpy as np

    from upvl_cli.perception.labels.looks import LookCandidates, choose_looks, pool_looks
    from upvl_cli.perception.labels.track_views import TrackViews
    from upvl_cli.perception.visual.pixel_source import PixelSource
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import concat

    (pca,) = inputs.table("pca", PcaRow)
    drive, poses = inputs.drive, list(inputs.table("odometry", OdometryRow))
    objects_of = _objects_by_frame(inputs, poses)
    views = TrackViews(
        drive.cameras,
        [pose.time_ns for pose in poses],
        [pose.world_from_ego for pose in poses],
        config.crop,
    )
    every = concat(
        list(in_order(lambda step: views.candidates(step, objects_of(poses[step].frame)), range(len(poses)))),
        LookCandidates,
    )
    chosen = choose_looks(every, config.choice)

    def look(step: int) -> list[ObjectLook]:
        """Look at what is chosen of a frame."""
        frame, found = poses[step].frame, []
        here = chosen[every.step[chosen] == step]
        objects = objects_of(frame)
        for number in np.unique(every.camera[here]).tolist():
            camera = views.cameras[number].name
            image, own = drive.image(frame, camera), here[every.camera[here] == number]
            if image is not None:
                given_px = drive.pixels(frame, camera) if isinstance(drive, PixelSource) else None
                found += views.looks(objects, every, own, image, given_px, inputs.model.embed_image)
        return found

    steps = np.unique(every.step[chosen]).tolist()
    looks = [each for found in in_order(look, steps) for each in found]
    inputs.count("candidates", len(every))
    inputs.count("looks", len(looks))
    number = np.array([each.candidate for each in looks], dtype=np.int64)
    return pool_looks(
        every.track_id[number],
        np.array([each.vector for each in looks]).reshape(-1, len(pca.mean)),
        every.quality[number],
        np.array([each.sharpness for each in looks]),
        pca.basis,
    )


def _objects_by_frame(inputs: Inputs, poses: list[OdometryRow]) -> Callable[[int], FrameObjects]:
    """Return the function that reads the labels of a frame and its sweep."""
    import numpy as np

    from upvl_cli.perception.labels.track_views import FrameObjects
    from upvl_cli.perception.odometry.compensation import compensated_points

    points_of = compensated_points(inputs.drive, poses)
    seen, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    labels = inputs.table("nms", AmodalRow)

    def objects(frame: int) -> FrameObjects:
        row, view = labels[frame], seen[frame]
        # Where no camera sees a point of the frame, its sweep is of no use.
        has_work = len(row.track_id) and (view.camera >= 0).any()
        xyz_m = points_of(frame).xyz_ego_m if has_work else np.zeros((len(view.state), 3))
        return FrameObjects(
            row.boxes, row.track_id, row.velocity_mps, xyz_m, view.state, view.camera, masks[frame].background
        )

    return objects


STAGE = Stage(
    name="looks",
    run=run,
    config=LooksConfig,
    row=LooksRow,
    reads=("raw", "vlm", "pca", "odometry", "extract-vl", "mask", "nms"),
    needs=Needs(gpus=1.0, memory_gib=4.0),
)
