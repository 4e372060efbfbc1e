"""The whole object behind what each sweep shows of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.rows import LabelRow
from upvl_cli.stage import Stage, param

if TYPE_CHECKING:
    from upvl_cli.algorithms.amodal import Sightings
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class AmodalParams:
    """Settings of `amodal`."""

    moving_mps: float = param("slower motion gives no heading", "m/s", least=0, most=200)
    foot_m: float = param("points lower than this have no say in length and width", "m", least=0, most=10)
    min_points: int = param("points that a frame needs to be registered", least=3, most=10**6)
    radius_m: float = param("pairs further apart are left out of the registration", "m", least=0.01, most=20)
    iterations: int = param("most steps of a registration", least=1, most=10_000)
    min_inlier_share: float = param(
        "a frame of which a smaller share finds its place is not registered", least=0, most=1
    )
    edge_share: float = param("an edge of a box is reached by this share of the frames", least=0.001, most=1)
    min_aspect: float = param("a vehicle is at least this many times as long as wide", least=1, most=100)
    max_background_share: float = param(
        "drop a track with a larger share of background among its points of all frames", least=0, most=1
    )


def run(inputs: Inputs, params: AmodalParams) -> Iterator[LabelRow]:
    """Give every track one size, and place that box in each of its frames."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.algorithms.amodal import amodal
    from upvl_cli.algorithms.suppression import support_score
    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.parallel import in_order

    tracked = inputs.table("track")
    rows, poses = list(tracked), inputs.table("odometry")
    step = np.repeat(np.arange(len(rows)), [len(row.seven) for row in rows])
    track_id = np.concatenate([row.track_id for row in rows] or [np.zeros(0, np.int64)])
    world = np.zeros((len(step), 7))
    frames_seen = np.zeros(len(step), np.int64)
    tracks = list(_sightings(inputs, step, track_id))
    settings = asdict(params)
    most = settings.pop("max_background_share")
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
        yield LabelRow(
            inputs.segment,
            row.frame,
            transform(world[here], inverse(poses[row.frame].world_from_ego)),
            row.velocity_mps[kept],
            row.points[kept],
            support_score(row.points[kept], frames_seen[here], background[here]),
            row.track_id[kept],
        )


def _background(inputs: Inputs, track_id: Array) -> Array:
    """(n,) share of background among the points of the track of each box, in all frames."""
    from upvl_cli.algorithms.masks import background_of_tracks

    proposals, masks = inputs.table("propose"), inputs.table("mask")
    frames = (
        (masks[row.frame].background, proposals[row.frame].box_of_point, row.proposal)
        for row in inputs.table("track")
    )
    return background_of_tracks(track_id, frames)


def _sightings(inputs: Inputs, step: Array, track_id: Array) -> Iterator[tuple[Array, Sightings]]:
    """Each track: which rows it has in all boxes, and what was seen of it, in world axes."""
    import numpy as np

    from upvl_cli.algorithms.amodal import Sightings
    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import apply
    from upvl_cli.parallel import in_order

    rows, poses = list(inputs.table("track")), inputs.table("odometry")
    grounds, proposals = inputs.table("ground"), inputs.table("propose")
    xyz_m, height_m, seven, velocity_mps, sensor_xy_m, sensor_heading_rad = [], [], [], [], [], []
    drive = inputs.drive
    sweeps = in_order(lambda row: drive.points(row.frame).xyz_ego_m, rows)
    for row, xyz_ego_m in zip(rows, sweeps, strict=True):
        pose = poses[row.frame].world_from_ego
        height, box_of_point = grounds[row.frame].height_m, proposals[row.frame].box_of_point
        for proposal in row.proposal:
            # A coasting box has proposal -1, which no point may be taken to belong to.
            mine = np.flatnonzero(box_of_point == proposal) if proposal >= 0 else np.zeros(0, np.int64)
            xyz_m.append(apply(pose, xyz_ego_m[mine]))
            height_m.append(height[mine].astype(np.float64))
        seven.append(transform(row.seven, pose))
        velocity_mps.append(row.velocity_mps @ pose[:3, :3].T)
        sensor_xy_m.append(np.tile(pose[:2, 3], (len(row.seven), 1)))
        sensor_heading_rad.append(np.full(len(row.seven), np.arctan2(pose[1, 0], pose[0, 0])))
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
    params=AmodalParams,
    row=LabelRow,
    reads=("raw", "odometry", "ground", "mask", "propose", "track"),
    version=5,
)
