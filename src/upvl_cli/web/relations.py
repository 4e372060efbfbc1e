"""Relations between found tracks: all boxes of the tracks of two answers are compared, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.query.compose import Moments, TimedBoxes, near, overtakings, stops
from upvl_cli.query.find import Hits
from upvl_cli.query.index import Objects
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, array, concat
from upvl_cli.web.answer import Answer
from upvl_cli.web.catalog import Catalog
from upvl_cli.web.parameters import Question

_KEYS = 2**40  # more frames, tracks and boxes than a drive has


@dataclass(frozen=True)
class TrackBoxes(ParallelArrays):
    """Boxes of found tracks: the hit that each belongs to, its drive, and its row among the boxes of the drive."""

    hit: Array = array("int64")
    drive: Array = array("int64")
    row: Array = array("int64")


def related(
    catalog: Catalog, answer: Answer, partners: Answer, question: Question, moving_mps: float
) -> Answer:
    """Return the hits of an answer for whose tracks a relation holds, at the moment that shows it best.

    Args:
        catalog: The boxes of all drives.
        answer: The tracks that are looked for.
        partners: The tracks that they are related to.
        question: The relation and its distances.
        moving_mps: Minimum speed of a moving box.
    """
    names = list(catalog.drives)
    first = _boxes_of_tracks(catalog.drives, answer.hits)
    boxes = _timed(catalog.drives, names, first)
    if question.relation == "stopped":
        moments = stops(boxes, min_stand_s=question.stand, moving_mps=moving_mps)
        best_last = moments.value
        others = first
    else:
        others = _boxes_of_tracks(catalog.drives, partners.hits)
        partner_boxes = _timed(catalog.drives, names, others)
        if question.relation == "near":
            moments = near(boxes, partner_boxes, question.within)
            best_last = -moments.value
        else:
            moments = overtakings(boxes, partner_boxes, max_lateral_m=question.within, moving_mps=moving_mps)
            best_last = -moments.value
    # Of each hit the best moment.
    hit = first.hit[moments.first]
    order = np.lexsort((-best_last, hit))
    chosen = moments[order[np.unique(hit[order], return_index=True)[1]]]
    hits = _at_moments(catalog.drives, names, answer.hits, first[chosen.first])
    remarks = tuple(_remarks(catalog.drives, names, others, chosen, question.relation))
    counts = dict(answer.counts) | {"tracks without the relation": len(answer.hits) - len(hits)}
    return replace(answer, hits=hits, remarks=remarks, counts=counts)


def _boxes_of_tracks(drives: Mapping[str, Objects], hits: Hits) -> TrackBoxes:
    """Return all boxes of the tracks of hits; a hit without a track is its own only box."""
    parts = []
    for number, (segment, objects) in enumerate(drives.items()):
        here = np.flatnonzero(hits.segment == segment)
        tracked = here[hits.track_id[here] >= 0]
        ids, place = np.unique(hits.track_id[tracked], return_index=True)
        rows = np.flatnonzero(np.isin(objects.track_id, ids))
        hit = tracked[place[np.searchsorted(ids, objects.track_id[rows])]] if len(ids) else rows
        single = here[hits.track_id[here] < 0]
        single_rows = np.searchsorted(objects.frame, hits.frame[single]) + hits.box[single]
        rows, hit = np.concatenate([rows, single_rows]), np.concatenate([hit, single])
        parts.append(TrackBoxes(hit, np.full(len(rows), number), rows))
    return concat(parts, TrackBoxes)


def _timed(drives: Mapping[str, Objects], names: list[str], boxes: TrackBoxes) -> TimedBoxes:
    parts = []
    for number in np.unique(boxes.drive).tolist():
        objects = drives[names[number]]
        rows = boxes.row[boxes.drive == number]
        chosen = objects[rows]
        object_id = np.where(chosen.track_id < 0, _KEYS // 2 + rows, chosen.track_id)
        parts.append(
            TimedBoxes(
                center_m=chosen.center_m,
                size_lwh_m=chosen.size_lwh_m,
                heading_rad=chosen.heading_rad,
                frame=number * _KEYS + chosen.frame,
                time_s=chosen.time_s,
                object_id=number * _KEYS + object_id,
                velocity_mps=chosen.velocity_mps,
            )
        )
    return concat(parts, TimedBoxes)


def _at_moments(drives: Mapping[str, Objects], names: list[str], hits: Hits, boxes: TrackBoxes) -> Hits:
    """Return the hits with the boxes of other moments of their tracks; scores and words stay those of the track."""
    moved = hits[boxes.hit]
    columns: dict[str, list[Floats | Ints]] = {name: [] for name in _OF_THE_BOX}
    for number, row in zip(boxes.drive.tolist(), boxes.row.tolist(), strict=True):
        objects = drives[names[number]]
        for name in _OF_THE_BOX:
            columns[name].append(getattr(objects, name)[row])
    return replace(moved, **{name: np.array(values) for name, values in columns.items()})


_OF_THE_BOX = (
    "frame", "box", "time_s", "center_m", "size_lwh_m", "heading_rad", "velocity_mps", "confidence", "num_features",
)  # fmt: skip


def _remarks(
    drives: Mapping[str, Objects], names: list[str], others: TrackBoxes, moments: Moments, relation: str
) -> list[str]:
    """Return one sentence for each moment."""
    remarks = []
    for second, value in zip(moments.second.tolist(), moments.value.tolist(), strict=True):
        if relation == "stopped":
            remarks.append(f"stops here and stands for {value:.1f} s")
            continue
        objects = drives[names[int(others.drive[second])]]
        track = int(objects.track_id[others.row[second]])
        name = f"track {track}" if track >= 0 else "a box without a track"
        remarks.append(
            f"{value:.1f} m from {name}" if relation == "near" else f"overtakes {name} in {value:.1f} s"
        )
    return remarks
