"""What the sweeps show of each track, frame by frame and part by part: what `amodal` fits boxes to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from upvl_cli.stages.rows import GroundRow, OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.perception.amodal.fit import KnownShape
    from upvl_cli.perception.amodal.track_parts import TrackTotals
    from upvl_cli.perception.objectness.config import ObjectnessConfig
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Bools, Ints


@dataclass(frozen=True)
class PendingFrame:
    """The kept boxes of a frame: `fitted` has a row of numbers, `FittedPart.rows`, for each that is fitted."""

    pose: OdometryRow
    tracks: TrackRow
    expected: int
    fitted: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Sighting:
    """What was seen of a track in a frame, in world axes.

    Attributes:
        frame: The frame.
        row: Row of its box there.
        xyz_m: (n, 3) its points.
        height_m: (n,) their heights over the ground.
        box: (7,) its box.
        velocity_mps: (3,) its velocity.
        ring_points: How many other points are around it.
    """

    frame: PendingFrame
    row: int
    xyz_m: Array
    height_m: Array
    box: Array
    velocity_mps: Array
    ring_points: int


@dataclass(frozen=True)
class TrackPart:
    """Consecutive boxes of one track, and what is known of it where they are not all."""

    sightings: list[Sighting]
    known: KnownShape | None


def sightings_of(
    inputs: Inputs, config: ObjectnessConfig, is_wanted: Callable[[TrackRow], Bools]
) -> Iterator[tuple[PendingFrame, list[Sighting]]]:
    """Yield each frame with what is seen of the wanted boxes."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import apply, rotate
    from upvl_cli.perception.objectness.ring import ring_counts
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    poses = inputs.table("odometry", OdometryRow)
    points_of = compensated_points(inputs.drive, poses)
    grounds, proposals = inputs.table("ground", GroundRow), inputs.table("propose", ProposalRow)

    def sightings(item: tuple[TrackRow, Bools]) -> tuple[PendingFrame, list[Sighting]]:
        row, wanted = item
        frame = PendingFrame(poses[row.frame], row, int(wanted.sum()))
        if not frame.expected:
            return frame, []
        xyz_ego_m, height_m = points_of(row.frame).xyz_ego_m, grounds[row.frame].height_m
        point_index = proposals[row.frame].point_index
        end = np.append(np.cumsum(point_index.count), 0)  # of no proposal, which is the last
        around = ring_counts(xyz_ego_m, height_m, row.boxes[wanted], config)
        world_from_ego = frame.pose.world_from_ego
        box_rows = transform(row.boxes, world_from_ego).to_rows()
        velocity_mps = rotate(world_from_ego, row.velocity_mps)
        xyz_m = apply(world_from_ego, xyz_ego_m[point_index.values])
        height_m = height_m[point_index.values].astype(np.float64)
        found = []
        for box, ring_points in zip(np.flatnonzero(wanted).tolist(), around.tolist(), strict=True):
            proposal = int(row.proposal[box])  # a coasting box has -1: no points
            own = slice(end[proposal - 1] if proposal else 0, end[proposal]) if proposal >= 0 else slice(0)
            # Copies: a view would hold the points of all boxes of the frame for as long as this track lasts.
            seen = xyz_m[own].copy(), height_m[own].copy()
            found.append(Sighting(frame, box, *seen, box_rows[box], velocity_mps[box], ring_points))
        return frame, found

    return in_order(sightings, ((row, is_wanted(row)) for row in inputs.table("track", TrackRow)))


def track_parts(
    sweeps: Iterator[tuple[PendingFrame, list[Sighting]]],
    totals: TrackTotals,
    parts: Ints,
    shapes: Mapping[int, KnownShape],
    pending: deque[PendingFrame],
) -> Iterator[TrackPart | None]:
    """Yield each part of a track once its last box was seen, and None after each frame.

    Args:
        sweeps: `sightings_of` the tracks that have a part.
        totals: Of each track.
        parts: (k,) number of parts of each track, 0 for one that is dropped.
        shapes: Size and heading of the tracks of several parts.
        pending: The frames that were read are appended.
    """
    from upvl_cli.perception.amodal.fit import KnownShape

    seen, begun = dict[int, int](), dict[int, list[Sighting]]()
    for frame, sightings in sweeps:
        pending.append(frame)
        for sighting in sightings:
            track_id = int(frame.tracks.track_id[sighting.row])
            number, rows, of_track = seen.get(track_id, 0), int(totals.rows[track_id]), int(parts[track_id])
            begun.setdefault(track_id, []).append(sighting)
            seen[track_id] = number + 1
            if number + 1 == rows or number * of_track // rows != (number + 1) * of_track // rows:
                ended, known = begun.pop(track_id), shapes.get(track_id)
                if known is not None:
                    here = known.heading_rad[number + 1 - len(ended) : number + 1]
                    known = KnownShape(known.size_lwh_m, here, known.moves)
                yield TrackPart(ended, known)
            if number + 1 == rows:
                del seen[track_id]
        yield None
