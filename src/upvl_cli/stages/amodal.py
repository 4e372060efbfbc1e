"""The whole object behind what each sweep shows of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import setting, table
from upvl_cli.perception.amodal.config import AmodalFitConfig
from upvl_cli.perception.labels.config import SupportScoreConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, GroundRow, MaskRow, OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.perception.amodal.sightings import Sightings
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Ints


@dataclass(frozen=True)
class AmodalConfig(AmodalFitConfig):
    """Settings of `amodal`."""

    max_background_share: float = setting(
        "largest share of background among the points of a track in all frames, r_bg; a track with more is dropped",
        ge=0,
        le=1,
    )
    score: SupportScoreConfig = table("confidence of a label")


def run(inputs: Inputs, config: AmodalConfig) -> Iterator[AmodalRow]:
    """Give every track one size, and place that box in each of its frames."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.amodal.fit import fit_amodal_boxes
    from upvl_cli.perception.labels.suppression import support_score
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import Boxes

    rows, poses = list(inputs.table("track", TrackRow)), inputs.table("odometry", OdometryRow)
    step = np.repeat(np.arange(len(rows)), [len(row.track_id) for row in rows])
    track_id = np.concatenate([np.zeros(0, np.int64), *(row.track_id for row in rows)])
    world, num_frames_seen = np.zeros((len(step), 7)), np.zeros(len(step), np.int64)
    tracks = list(_sightings(inputs, track_id))
    boxes_of_tracks = in_order(lambda track: fit_amodal_boxes(track[1], config), tracks)
    background_share = _background_share(inputs, track_id)
    is_object = background_share <= config.max_background_share
    for (here, seen), boxes in zip(tracks, boxes_of_tracks, strict=True):
        world[here] = boxes.to_rows()
        num_frames_seen[here] = sum(len(xyz_m) > 0 for xyz_m in seen.xyz_m)
        inputs.count("tracks dropped: background", not is_object[here[0]])
        inputs.count("tracks kept", is_object[here[0]])
    world_boxes = Boxes.from_rows(world)
    for number, row in enumerate(rows):
        in_frame = step == number
        is_kept = is_object[in_frame]
        here = np.flatnonzero(in_frame)[is_kept]
        inputs.count("boxes", len(here))
        boxes = transform(world_boxes[here], inverse(poses[row.frame].world_from_ego))
        num_points = row.num_points[is_kept]
        yield AmodalRow(
            inputs.segment,
            row.frame,
            row.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            row.velocity_mps[is_kept],
            num_points,
            support_score(num_points, num_frames_seen[here], background_share[here], config.score),
            row.track_id[is_kept],
            background_share[here],
            num_frames_seen[here],
        )


def _background_share(inputs: Inputs, track_id: Ints) -> Array:
    """Return (n,) share of background among the points of the track of each box, in all frames."""
    from upvl_cli.perception.background.masks import background_of_tracks

    proposals, masks = inputs.table("propose", ProposalRow), inputs.table("mask", MaskRow)
    frames = (
        (
            masks[row.frame].background,
            proposals[row.frame].box_of_point(len(masks[row.frame].background)),
            row.proposal,
        )
        for row in inputs.table("track", TrackRow)
    )
    return background_of_tracks(track_id, frames)


def _sightings(inputs: Inputs, track_id: Ints) -> Iterator[tuple[Ints, Sightings]]:
    """Yield each track: its rows among all boxes, and what was seen of it, in world axes."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import apply, rotate, yaw_of
    from upvl_cli.perception.amodal.sightings import Sightings
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import Boxes, concat

    rows, poses = list(inputs.table("track", TrackRow)), inputs.table("odometry", OdometryRow)
    grounds, proposals = inputs.table("ground", GroundRow), inputs.table("propose", ProposalRow)
    xyz_m, height_m, boxes = [], [], []
    velocity_mps, sensor_xy_m, sensor_heading_rad = [np.zeros((0, 3))], [np.zeros((0, 2))], [np.zeros(0)]
    drive = inputs.drive
    sweeps = in_order(lambda row: drive.points(row.frame).xyz_ego_m, rows)
    for row, xyz_ego_m in zip(rows, sweeps, strict=True):
        pose = poses[row.frame].world_from_ego
        height = grounds[row.frame].height_m
        box_of_point = proposals[row.frame].box_of_point(len(height))
        for proposal in row.proposal:
            # A coasting box has proposal -1, which no point may be taken to belong to.
            points = np.flatnonzero((box_of_point == proposal) & (proposal >= 0))
            xyz_m.append(apply(pose, xyz_ego_m[points]))
            height_m.append(height[points].astype(np.float64))
        boxes.append(transform(row.boxes, pose))
        velocity_mps.append(rotate(pose, row.velocity_mps))
        sensor_xy_m.append(np.tile(pose[:2, 3], (len(row.track_id), 1)))
        sensor_heading_rad.append(np.full(len(row.track_id), yaw_of(pose)))
    velocity, sensor_xy, sensor_heading = (
        np.concatenate(parts) for parts in (velocity_mps, sensor_xy_m, sensor_heading_rad)
    )
    all_boxes = concat(boxes, Boxes)
    for number in np.unique(track_id):
        here = np.flatnonzero(track_id == number)
        yield (
            here,
            Sightings(
                [xyz_m[box] for box in here],
                [height_m[box] for box in here],
                all_boxes[here],
                velocity[here],
                sensor_xy[here],
                sensor_heading[here],
            ),
        )


STAGE = Stage(
    name="amodal",
    run=run,
    config=AmodalConfig,
    row=AmodalRow,
    reads=("raw", "odometry", "ground", "mask", "propose", "track"),
    version=5,
)
