"""The whole object behind what each sweep shows of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import setting, table
from upvl_cli.perception.amodal.config import AmodalFitConfig
from upvl_cli.perception.labels.config import BoxScoreConfig
from upvl_cli.perception.objectness.config import ObjectnessConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, MaskRow, OdometryRow, ProposalRow, TrackRow

if TYPE_CHECKING:
    from upvl_cli.perception.amodal.fit import KnownShape
    from upvl_cli.perception.amodal.track_parts import TrackTotals
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.stages.track_sightings import PendingFrame, Sighting, TrackPart
    from upvl_cli.types import Array, Bools, Floats, Ints


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
    score: BoxScoreConfig = table("confidence of a label")
    objectness: ObjectnessConfig = table("what a track's likeness to road users is measured on")


def run(inputs: Inputs, config: AmodalConfig) -> Iterator[AmodalRow]:
    """Give every track one size, place that box in each of its frames, and score it by its likeness to road users."""
    import numpy as np

    from upvl_cli.perception.objectness.prior import shipped_prior

    totals, prior = track_totals(inputs), shipped_prior()
    pending: deque[PendingFrame] = deque()
    for fitted in fitted_parts(inputs, totals, config, pending):
        if fitted is not None:
            objectness = prior.probability(fitted.features[None])[0]
            extra = [objectness, fitted.sides_seen, fitted.residual_m]
            for sighting, row in zip(fitted.part.sightings, fitted.rows, strict=True):
                sighting.frame.fitted[sighting.row] = np.append(row, extra)
        while pending and len(pending[0].fitted) == pending[0].expected:
            yield _row(inputs, pending.popleft(), totals, config)


@dataclass(frozen=True)
class FittedPart:
    """A part of a track with its boxes.

    Attributes:
        part: What was seen of it.
        rows: (T, 7) boxes in world axes.
        features: (f,) what its likeness to road users is measured on, `objectness.track_features.FEATURES`.
        sides_seen: How many of its four sides faced the sensor.
        residual_m: By how much its registered clouds differ; -1 where fewer than two are.
    """

    part: TrackPart
    rows: Array
    features: Floats
    sides_seen: int
    residual_m: float


def fitted_parts(
    inputs: Inputs, totals: TrackTotals, config: AmodalConfig, pending: deque[PendingFrame]
) -> Iterator[FittedPart | None]:
    """Yield each part of a track with its boxes once its last box was seen, and None after each frame.

    Args:
        inputs: Of the stage.
        totals: What is known of each track.
        config: Settings.
        pending: The frames that were read are appended.
    """
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.stages.track_sightings import sightings_of, track_parts

    is_object = totals.background_share <= config.max_background_share
    inputs.count("tracks dropped: background", ((totals.rows > 0) & ~is_object).sum())
    inputs.count("tracks kept", ((totals.rows > 0) & is_object).sum())
    parts = totals.parts(config.window_s) * is_object
    shapes = _shapes_of_long_tracks(inputs, totals, parts, config)
    sweeps = sightings_of(inputs, config.objectness, lambda row: parts[row.track_id] > 0)
    return in_order(
        lambda part: None if part is None else fit_part(part, config),
        track_parts(sweeps, totals, parts, shapes, pending),
    )


def track_totals(inputs: Inputs) -> TrackTotals:
    """Return what is known of each track from its points' states in all frames.

    Of what a 2D box shows the state is unknown: a detector outweighs the words of single points.
    """
    import numpy as np

    from upvl_cli.perception.amodal.track_parts import TrackTotals, points_of_boxes

    proposals, masks = inputs.table("propose", ProposalRow), inputs.table("mask", MaskRow)
    totals = TrackTotals()
    for row in inputs.table("track", TrackRow):
        proposal = proposals[row.frame]
        points = proposal.point_index
        state = np.where(proposal.is_lifted[points.owner], -1, masks[row.frame].background[points.values])
        num_points = points_of_boxes(state, points.owner, row.proposal)
        totals.add(row.track_id, row.time_ns * 1e-9, num_points)
    return totals


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
    from upvl_cli.stages.track_sightings import TrackPart, sightings_of
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

    samples: dict[int, list[Sighting]] = {track_id: [] for track_id in chosen}
    for frame, sightings in sightings_of(inputs, config.objectness, is_chosen):
        for sighting in sightings:
            samples[int(frame.tracks.track_id[sighting.row])].append(sighting)
    shapes = {}
    for track_id, sample in samples.items():
        size_and_heading = fit_part(TrackPart(sample, None), config).rows[0, 3:7]
        through = Boxes.from_rows(np.array(box_rows[track_id]))
        heading_rad = moving_headings(through, np.array(velocity_mps[track_id]), config.heading)
        moves = heading_rad is not None
        if heading_rad is None:
            heading_rad = np.full(totals.rows[track_id], size_and_heading[3])
        shapes[track_id] = KnownShape(size_and_heading[:3], heading_rad, moves)
    return shapes


def fit_part(part: TrackPart, config: AmodalConfig) -> FittedPart:
    """Fit the boxes of a part of a track, and measure its shape."""
    import numpy as np

    from upvl_cli.geometry.se3 import yaw_of
    from upvl_cli.perception.amodal.fit import fit_amodal_boxes
    from upvl_cli.perception.amodal.sightings import Sightings
    from upvl_cli.perception.objectness.track_features import track_features
    from upvl_cli.types import Boxes

    sightings = part.sightings
    poses = np.array([sighting.frame.pose.world_from_ego for sighting in sightings])
    seen = Sightings(
        np.array([sighting.frame.pose.time_ns * 1e-9 for sighting in sightings]),
        [sighting.xyz_m for sighting in sightings],
        [sighting.height_m for sighting in sightings],
        Boxes.from_rows(np.array([sighting.box for sighting in sightings])),
        np.array([sighting.velocity_mps for sighting in sightings]),
        poses[:, :2, 3],
        yaw_of(poses),
    )
    fit = fit_amodal_boxes(seen, config, part.known)
    ring_points = np.array([sighting.ring_points for sighting in sightings])
    features = track_features(seen, fit.boxes, ring_points, config.objectness)
    return FittedPart(part, fit.boxes.to_rows(), features, fit.sides_seen, fit.residual_m)


def _row(inputs: Inputs, frame: PendingFrame, totals: TrackTotals, config: AmodalConfig) -> AmodalRow:
    """Return the boxes of a frame of which every track is fitted."""
    import numpy as np

    from upvl_cli.geometry.boxes import transform
    from upvl_cli.geometry.se3 import inverse
    from upvl_cli.perception.labels.suppression import box_score
    from upvl_cli.types import Boxes

    tracks, kept = frame.tracks, np.array(sorted(frame.fitted), dtype=np.int64)
    inputs.count("boxes", len(kept))
    values = np.array([frame.fitted[row] for row in kept.tolist()]).reshape(-1, 10)
    boxes = transform(Boxes.from_rows(values[:, :7]), inverse(frame.pose.world_from_ego))
    track_id, num_points = tracks.track_id[kept], tracks.num_points[kept]
    share = totals.background_share[track_id]
    return AmodalRow(
        inputs.segment,
        tracks.frame,
        tracks.time_ns,
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        tracks.velocity_mps[kept],
        num_points,
        box_score(values[:, 7], num_points, share, config.score),
        track_id,
        share,
        totals.num_frames_seen[track_id],
        objectness=values[:, 7],
        sides_seen=values[:, 8].astype(np.int8),
        residual_m=values[:, 9],
    )


STAGE = Stage(
    name="amodal",
    run=run,
    config=AmodalConfig,
    row=AmodalRow,
    reads=("raw", "odometry", "ground", "mask", "propose", "track"),
    version=7,
)
