"""What a person changed: the boxes that came back against the labels that went out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.export.corrections import Corrections
from upvl_cli.export.drive import ExportBoxes
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.stages.correction_rows import DELETED, MOVED, NEW, RENAMED
from upvl_cli.types import Array, Bools, Ints, concat

# Formats round to a millimetre at worst, and tools to a hundredth of a degree.
_SAME_M, _SAME_RAD = 0.005, np.deg2rad(0.05)
_ROUNDING = 1e-6  # spare room for the last digits of half a step
_MAX_MOVE_M = 10.0  # a box of the same id further away is another object: some tools number anew
_MAX_DRIFT_M = 2.0  # boxes of other ids are one object up to here: half a lane


@dataclass(frozen=True)
class Differences:
    """What changed in one drive.

    Attributes:
        corrections: The changed boxes.
        kept: Number of labels that are as they were.
    """

    corrections: Corrections
    kept: int


def differences(
    labels: ExportBoxes, edited: ExportBoxes, went_out: Bools, tool_step: float = 0.0
) -> Differences:
    """Return what a person changed in the labels of a drive.

    A box is that of a label if it has its frame and track, or else if the two are nearest to each other. A box that
    is none of any label keeps its track, or gets a new one where that number is another object's.

    Args:
        labels: The n auto labels.
        edited: The boxes that came back; NaN velocities are unknown.
        went_out: (n,) which labels the person was given; of the others nothing is known.
        tool_step: As of `ExportFormat`: what rounding alone can have changed counts as kept.
    """
    outgoing = labels[went_out]
    of_label = _matches(outgoing, edited)
    matched = of_label >= 0
    before, after = outgoing[of_label[matched]], edited[matched]
    has_moved, has_name = _has_moved(before, after, tool_step), before.class_name != after.class_name
    changed = has_moved | has_name
    after = replace(after, track_id=before.track_id, velocity_mps=before.velocity_mps)
    change = np.where(has_moved, MOVED, RENAMED)
    new = edited[~matched]
    new = replace(new, track_id=_new_tracks(new.track_id, edited, of_label, outgoing, labels))
    gone = np.ones(len(outgoing), dtype=np.bool_)
    gone[of_label[matched]] = False
    parts = [
        _corrections(after[changed], change[changed], 1.0),
        _corrections(new, np.full(len(new), NEW), 1.0),
        _corrections(outgoing[gone], np.full(int(gone.sum()), DELETED), 0.0),
    ]
    corrections = concat(parts, Corrections)
    order = np.lexsort([corrections.track_id, corrections.frame])
    return Differences(corrections[order], int((~changed).sum()))


def _matches(labels: ExportBoxes, edited: ExportBoxes) -> Ints:
    """Return (m,) the label of each edited box, -1 where it is of none."""
    found = np.full(len(edited), -1)
    for here, there in _by_frame(labels, edited):
        distance = np.linalg.norm(labels.center_m[here][:, None] - edited.center_m[there][None], axis=-1)
        same_id = labels.track_id[here][:, None] == edited.track_id[there][None]
        close_id = same_id & (distance <= _MAX_MOVE_M)
        # An id counts for more than any distance: the box of a track stays that of the track.
        cost = np.where(
            close_id, distance - 10 * _MAX_MOVE_M, np.where(distance <= _MAX_DRIFT_M, distance, 1e6)
        )
        rows, columns = linear_sum_assignment(cost)
        fine = cost[rows, columns] < 1e6
        found[there[columns[fine]]] = here[rows[fine]]
    return found


def _by_frame(labels: ExportBoxes, edited: ExportBoxes) -> Iterator[tuple[Ints, Ints]]:
    """Yield the places of the labels and of the edited boxes of each frame that has both."""
    for frame in np.intersect1d(labels.frame, edited.frame):
        yield np.flatnonzero(labels.frame == frame), np.flatnonzero(edited.frame == frame)


def _has_moved(before: ExportBoxes, after: ExportBoxes, tool_step: float) -> Bools:
    """Return (n,) whether a box has another place, size or heading."""
    shift = np.abs(after.center_m - before.center_m).max(axis=1, initial=0.0)
    growth = np.abs(after.size_lwh_m - before.size_lwh_m).max(axis=1, initial=0.0)
    turn = np.abs(wrap_angle(after.heading_rad - before.heading_rad))
    rounded = tool_step / 2 + _ROUNDING
    same_m, same_rad = max(_SAME_M, rounded), max(_SAME_RAD, rounded)
    return np.asarray((shift > same_m) | (growth > same_m) | (turn > same_rad))


def _new_tracks(
    ids: Ints, edited: ExportBoxes, of_label: Ints, outgoing: ExportBoxes, labels: ExportBoxes
) -> Ints:
    """Return the track of each box that no label had.

    A person who fills a gap of a track uses its id: where other boxes of that id are labels of one track, it is that
    track. Other ids get numbers that no label has.
    """
    following = max(labels.track_id.max(initial=-1), edited.track_id.max(initial=-1)) + 1
    matched = of_label >= 0
    tracks: dict[int, int] = {}
    for number in dict.fromkeys(ids.tolist()):
        known = outgoing.track_id[of_label[matched & (edited.track_id == number)]]
        if len(known):
            tracks[number] = int(np.bincount(known).argmax())
        elif number in labels.track_id:
            tracks[number], following = following, following + 1
        else:
            tracks[number] = number
    return np.array([tracks[number] for number in ids.tolist()], dtype=np.int64)


def _corrections(boxes: ExportBoxes, change: Array, score: float) -> Corrections:
    columns = {name: getattr(boxes, name) for name in boxes.__dataclass_fields__}
    return Corrections(**columns | {"score": np.full(len(boxes), score)}, change=change)
