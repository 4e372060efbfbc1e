"""Hits that are near other hits."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from upvl_cli.query.compose import TimedBoxes, near
from upvl_cli.query.find import Hits, QueryResult
from upvl_cli.types import Ints

_FRAMES = 2**32  # more frames than a drive has


def near_hits(result: QueryResult, partners: Hits, within_m: float) -> QueryResult:
    """Return the hits that have a partner near them in the same frame, in their order.

    Args:
        result: The hits, and how many boxes there were of each fate.
        partners: Boxes of which one must be near; a box is not near its own track.
        within_m: Largest horizontal gap between the footprints.
    """
    names = np.unique(np.concatenate([result.hits.segment, partners.segment]))
    first, second = (_timed_boxes(hits, names.searchsorted(hits.segment)) for hits in (result.hits, partners))
    kept = near(first, second, within_m).first
    counts = Counter(result.counts)
    counts["not near"] = len(result.hits) - len(kept)
    counts["hits"] = len(kept)
    return replace(result, hits=result.hits[kept], counts=counts)


def _timed_boxes(hits: Hits, drive: Ints) -> TimedBoxes:
    frame = drive * _FRAMES + hits.frame
    # A box without a track is an object of its own: the same in both lists of hits, and in no other frame.
    object_id = np.where(hits.track_id < 0, -1 - (frame * 2**12 + hits.box), drive * _FRAMES + hits.track_id)
    return TimedBoxes(
        center_m=hits.center_m,
        size_lwh_m=hits.size_lwh_m,
        heading_rad=hits.heading_rad,
        frame=frame,
        time_s=hits.time_s,
        object_id=object_id,
        velocity_mps=hits.velocity_mps,
    )
