"""The whole object behind what each sweep shows of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.labels.config import SupportScoreConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, GroundRow, MaskRow, OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.perception.amodal.fit import Sightings
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class AmodalConfig(Config):
    """Settings of `amodal`."""

    moving_mps: float = setting("slower motion gives no heading", "m/s", ge=0, le=200)
    foot_m: float = setting("points lower than this have no say in length and width", "m", ge=0, le=10)
    min_points: int = setting("points that a frame needs to be registered", ge=3, le=10**6)
    radius_m: float = setting("pairs further apart are left out of the registration", "m", ge=0.01, le=20)
    iterations: int = setting("most steps of a registration", ge=1, le=10_000)
    min_inlier_share: float = setting(
        "a frame of which a smaller share finds its place is not registered", ge=0, le=1
    )
    edge_share: float = setting("an edge of a box is reached by this share of the frames", ge=0.001, le=1)
    min_aspect: float = setting("a vehicle is at least this many times as long as wide", ge=1, le=100)
    max_background_share: float = setting(
        "drop a track with a larger share of background among its points of all frames", ge=0, le=1
    )
    score: SupportScoreConfig = table("confidence of a label")


def run(inputs: Inputs, config: AmodalConfig) -> Iterator[AmodalRow]:
    """Give every track one size, and place that box in each of its frames."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.amodal.fit import amodal
    from upvl_cli.perception.labels.suppression import support_score
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import Boxes

    tracked = inputs.table("track", TrackRow)
    rows, poses = list(tracked), inputs.table("odometry", OdometryRow)
    step = np.repeat(np.arange(len(rows)), [len(row.track_id) for row in rows])
    track_id = np.concatenate([row.track_id for row in rows] or [np.zeros(0, np.int64)])
    world = np.zeros((len(step), 7))
    frames_seen = np.zeros(len(step), np.int64)
    tracks = list(_sightings(inputs, step, track_id))
    settings = asdict(config)
    most = settings.pop("max_background_share")
    del settings["score"]
    boxes_of = in_order(lambda track: amodal(track[1], **settings), tracks)
    background = _background(inputs, track_id)
    for (here, sightings), boxes in zip(tracks, boxes_of, strict=True):
        world[here] = boxes
        frames_seen[here] = sum(len(xyz) > 0 for xyz in sightings.xyz_m)
        inputs.count("tracks dropped: background", background[here[0]] > most)
        inputs.count("tracks kept", background[here[0]] <= most)
    for number, row in enumerate(rows):
        mine = step == number
        kept = background[mine] <= most
        here = np.flatnonzero(mine)[kept]
        inputs.count("boxes", len(here))
        boxes = transform(Boxes.from_rows(world[here]), inverse(poses[row.frame].world_from_ego))
        yield AmodalRow(
            inputs.segment,
            row.frame,
            row.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            row.velocity_mps[kept],
            row.num_points[kept],
            support_score(row.num_points[kept], frames_seen[here], background[here], config.score),
            row.track_id[kept],
            background[here],
            frames_seen[here],
        )


def _background(inputs: Inputs, track_id: Array) -> Array:
    """(n,) share of background among the points of the track of each box, in all frames."""
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


def _sightings(inputs: Inputs, step: Array, track_id: Array) -> Iterator[tuple[Array, Sightings]]:
    """Each track: which rows it has in all boxes, and what was seen of it, in world axes."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.amodal.fit import Sightings
    from upvl_cli.runtime.parallel import in_order

    rows, poses = list(inputs.table("track", TrackRow)), inputs.table("odometry", OdometryRow)
    grounds, proposals = inputs.table("ground", GroundRow), inputs.table("propose", ProposalRow)
    xyz_m, height_m, seven, velocity_mps, sensor_xy_m, sensor_heading_rad = [], [], [], [], [], []
    drive = inputs.drive
    sweeps = in_order(lambda row: drive.points(row.frame).xyz_ego_m, rows)
    for row, xyz_ego_m in zip(rows, sweeps, strict=True):
        pose = poses[row.frame].world_from_ego
        height = grounds[row.frame].height_m
        box_of_point = proposals[row.frame].box_of_point(len(height))
        for proposal in row.proposal:
            # A coasting box has proposal -1, which no point may be taken to belong to.
            mine = np.flatnonzero(box_of_point == proposal) if proposal >= 0 else np.zeros(0, np.int64)
            xyz_m.append(apply(pose, xyz_ego_m[mine]))
            height_m.append(height[mine].astype(np.float64))
        seven.append(transform(row.boxes.to_rows(), pose))
        velocity_mps.append(row.velocity_mps @ pose[:3, :3].T)
        sensor_xy_m.append(np.tile(pose[:2, 3], (len(row.track_id), 1)))
        sensor_heading_rad.append(np.full(len(row.track_id), np.arctan2(pose[1, 0], pose[0, 0])))
    columns = [
        np.concatenate(parts) if parts else np.zeros((0, 7))
        for parts in (seven, velocity_mps, sensor_xy_m, sensor_heading_rad)
    ]
    for number in np.unique(track_id):
        here = np.flatnonzero(track_id == number)
        clouds, heights = [xyz_m[box] for box in here], [height_m[box] for box in here]
        yield here, Sightings(clouds, heights, *(column[here] for column in columns))


STAGE = Stage(
    name="amodal",
    run=run,
    config=AmodalConfig,
    row=AmodalRow,
    reads=("raw", "odometry", "ground", "mask", "propose", "track"),
    version=5,
)
