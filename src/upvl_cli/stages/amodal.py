"""The whole object behind what each sweep shows of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from upvl_cli.config.base import setting, table
from upvl_cli.perception.amodal.config import AmodalFitConfig
from upvl_cli.perception.labels.config import SupportScoreConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, GroundRow, MaskRow, OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.perception.amodal.fit import KnownShape
    from upvl_cli.perception.amodal.track_parts import TrackTotals
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Bools, Ints


@dataclass(frozen=True)
class AmodalConfig(AmodalFitConfig):
    """Settings of `amodal`."""

    max_background_share: float = setting(
        "largest share of background among the points of a track in all frames, r_bg; a track with more is dropped",
        ge=0,
        le=1,
    )
    window_s: float = setting(
        "length of the parts in which a track that lasts longer is placed; the points of one part are held",
        "s",
        ge=1,
        le=3600,
    )
    max_sightings: int = setting(
        "frames of a track of several parts, spread evenly over it, that its size is fitted to",
        ge=2,
        le=10**6,
    )
    score: SupportScoreConfig = table("confidence of a label")


def run(inputs: Inputs, config: AmodalConfig) -> Iterator[AmodalRow]:
    """Give every track one size, and place that box in each of its frames."""
    from upvl_cli.runtime.parallel import in_order

    totals = _totals(inputs)
    is_object = totals.background_share <= config.max_background_share
    inputs.count("tracks dropped: background", ((totals.rows > 0) & ~is_object).sum())
    inputs.count("tracks kept", ((totals.rows > 0) & is_object).sum())
    parts = totals.parts(config.window_s) * is_object
    shapes = _shapes_of_long_tracks(inputs, totals, parts, config)
    pending: deque[_Frame] = deque()
    for part, boxes in in_order(
        lambda part: _fit(config, part), _parts(inputs, totals, parts, shapes, pending)
    ):
        for sighting, box in zip(part.sightings if part else (), boxes, strict=True):
            sighting.frame.boxes[sighting.row] = box
        while pending and len(pending[0].boxes) == pending[0].expected:
            yield _row(inputs, pending.popleft(), totals, config)


@dataclass(frozen=True)
class _Frame:
    """The kept boxes of a frame: `boxes` has a row of seven numbers for each that is fitted."""

    pose: OdometryRow
    tracks: TrackRow
    expected: int
    boxes: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Sighting:
    """What was seen of a track in a frame: its box, and its points as the sweep has them."""

    frame: _Frame
    row: int
    xyz_ego_m: Array
    height_m: Array


@dataclass(frozen=True)
class _Part:
    """Consecutive boxes of one track, and what is known of it where they are not all."""

    sightings: list[_Sighting]
    known: KnownShape | None


def _totals(inputs: Inputs) -> TrackTotals:
    """Return what is known of each track from its points' states in all frames."""
    from upvl_cli.perception.amodal.track_parts import TrackTotals, points_of_boxes

    proposals, masks = inputs.table("propose", ProposalRow), inputs.table("mask", MaskRow)
    totals = TrackTotals()
    for row in inputs.table("track", TrackRow):
        points = proposals[row.frame].point_index
        state = masks[row.frame].background[points.values]
        num_points = points_of_boxes(state, points.owner, row.proposal)
        totals.add(row.track_id, row.time_ns * 1e-9, num_points)
    return totals


def _sightings(
    inputs: Inputs, is_wanted: Callable[[TrackRow], Bools]
) -> Iterator[tuple[_Frame, list[_Sighting]]]:
    """Yield each frame with what is seen of the wanted boxes."""
    import numpy as np

    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.runtime.parallel import in_order

    poses = inputs.table("odometry", OdometryRow)
    points_of = compensated_points(inputs.drive, poses)
    grounds, proposals = inputs.table("ground", GroundRow), inputs.table("propose", ProposalRow)

    def sightings(item: tuple[TrackRow, Bools]) -> tuple[_Frame, list[_Sighting]]:
        row, wanted = item
        frame = _Frame(poses[row.frame], row, int(wanted.sum()))
        if not frame.expected:
            return frame, []
        xyz_ego_m, height_m = points_of(row.frame).xyz_ego_m, grounds[row.frame].height_m
        point_index = proposals[row.frame].point_index
        end = np.append(np.cumsum(point_index.count), 0)  # of no proposal, which is the last
        found = []
        for box in np.flatnonzero(wanted).tolist():
            proposal = int(row.proposal[box])  # a coasting box has -1: no points
            points = point_index.values[end[proposal - 1] if proposal else 0 : end[proposal]]
            points = points if proposal >= 0 else points[:0]
            found.append(_Sighting(frame, box, xyz_ego_m[points], height_m[points]))
        return frame, found

    return in_order(sightings, ((row, is_wanted(row)) for row in inputs.table("track", TrackRow)))


def _parts(
    inputs: Inputs, totals: TrackTotals, parts: Ints, shapes: Mapping[int, KnownShape], pending: deque[_Frame]
) -> Iterator[_Part | None]:
    """Yield each part of a track once its last box was seen, and None after each frame.

    Args:
        inputs: Of the stage.
        totals: Of each track.
        parts: (k,) number of parts of each track, 0 for one that is dropped.
        shapes: Size and heading of the tracks of several parts.
        pending: The frames that were read are appended.
    """
    from upvl_cli.perception.amodal.fit import KnownShape

    seen, begun = dict[int, int](), dict[int, list[_Sighting]]()
    for frame, sightings in _sightings(inputs, lambda row: parts[row.track_id] > 0):
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
                yield _Part(ended, known)
            if number + 1 == rows:
                del seen[track_id]
        yield None


def _shapes_of_long_tracks(
    inputs: Inputs, totals: TrackTotals, parts: Ints, config: AmodalConfig
) -> dict[int, KnownShape]:
    """Return one size for each track of several parts, from frames spread over all of it, and its headings."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import rotate
    from upvl_cli.perception.amodal.fit import KnownShape
    from upvl_cli.perception.amodal.heading import moving_headings
    from upvl_cli.perception.amodal.track_parts import spread
    from upvl_cli.types import Boxes

    chosen = {
        k: set(spread(int(totals.rows[k]), config.max_sightings)) for k in np.flatnonzero(parts > 1).tolist()
    }
    if not chosen:
        return {}
    velocity_mps: dict[int, list[Array]] = {track_id: [] for track_id in chosen}
    box_rows: dict[int, list[Array]] = {track_id: [] for track_id in chosen}
    poses = inputs.table("odometry", OdometryRow)

    def is_chosen(row: TrackRow) -> Bools:
        world_from_ego = poses[row.frame].world_from_ego
        turned = rotate(world_from_ego, row.velocity_mps)[:, :2]
        placed = transform(row.boxes, world_from_ego).to_rows()
        wanted = np.zeros(len(row.track_id), dtype=np.bool_)
        for box, track_id in enumerate(row.track_id.tolist()):
            if track_id in chosen:
                wanted[box] = len(velocity_mps[track_id]) in chosen[track_id]
                velocity_mps[track_id].append(turned[box])
                box_rows[track_id].append(placed[box])
        return wanted

    samples: dict[int, list[_Sighting]] = {track_id: [] for track_id in chosen}
    for frame, sightings in _sightings(inputs, is_chosen):
        for sighting in sightings:
            samples[int(frame.tracks.track_id[sighting.row])].append(sighting)
    shapes = {}
    for track_id, sample in samples.items():
        _, boxes = _fit(config, _Part(sample, None))
        through = Boxes.from_rows(np.array(box_rows[track_id]))
        heading_rad = moving_headings(through, np.array(velocity_mps[track_id]), config.heading)
        moves = heading_rad is not None
        if heading_rad is None:
            heading_rad = np.full(totals.rows[track_id], boxes[0, 6])
        shapes[track_id] = KnownShape(boxes[0, 3:6], heading_rad, moves)
    return shapes


def _fit(config: AmodalConfig, part: _Part | None) -> tuple[_Part | None, Array]:
    """Return (T, 7) boxes of a part in world axes; none for none."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import apply, rotate, yaw_of
    from upvl_cli.perception.amodal.fit import fit_amodal_boxes
    from upvl_cli.perception.amodal.sightings import Sightings
    from upvl_cli.types import Boxes, concat

    if part is None:
        return None, np.zeros((0, 7))
    seen = part.sightings
    poses = [sighting.frame.pose.world_from_ego for sighting in seen]
    velocity_mps = [sighting.frame.tracks.velocity_mps[sighting.row] for sighting in seen]
    boxes = [sighting.frame.tracks.boxes[[sighting.row]] for sighting in seen]
    fitted = fit_amodal_boxes(
        Sightings(
            np.array([sighting.frame.pose.time_ns * 1e-9 for sighting in seen]),
            [apply(pose, sighting.xyz_ego_m) for pose, sighting in zip(poses, seen, strict=True)],
            [sighting.height_m.astype(np.float64) for sighting in seen],
            concat([transform(box, pose) for box, pose in zip(boxes, poses, strict=True)], Boxes),
            np.array(
                [rotate(pose, velocity[None])[0] for pose, velocity in zip(poses, velocity_mps, strict=True)]
            ),
            np.array([pose[:2, 3] for pose in poses]),
            np.array([yaw_of(pose) for pose in poses]),
        ),
        config,
        part.known,
    )
    return part, fitted.to_rows()


def _row(inputs: Inputs, frame: _Frame, totals: TrackTotals, config: AmodalConfig) -> AmodalRow:
    """Return the boxes of a frame of which every track is fitted."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.labels.suppression import support_score
    from upvl_cli.types import Boxes

    tracks, kept = frame.tracks, np.array(sorted(frame.boxes), dtype=np.int64)
    inputs.count("boxes", len(kept))
    world = Boxes.from_rows(np.array([frame.boxes[row] for row in kept.tolist()]))
    boxes = transform(world, inverse(frame.pose.world_from_ego))
    track_id, num_points = tracks.track_id[kept], tracks.num_points[kept]
    num_frames_seen, share = totals.num_frames_seen[track_id], totals.background_share[track_id]
    return AmodalRow(
        inputs.segment,
        tracks.frame,
        tracks.time_ns,
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        tracks.velocity_mps[kept],
        num_points,
        support_score(num_points, num_frames_seen, share, config.score),
        track_id,
        share,
        num_frames_seen,
    )


STAGE = Stage(
    name="amodal",
    run=run,
    config=AmodalConfig,
    row=AmodalRow,
    reads=("raw", "odometry", "ground", "mask", "propose", "track"),
    version=6,
)
