"""Which picture belongs to which sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.nuscenes.records import SensorFile

# A picture belongs to the turn of the LiDAR in which it was taken, which ends at the time of the sweep.
_MAX_PERIODS = 1.5
_PERIOD_NS = 100_000_000  # for a scene with one sweep


@dataclass(frozen=True)
class IndexedSweep:
    """One frame: its index and its file."""

    index: int
    record: SensorFile


def pictures_of(sweeps: Sequence[IndexedSweep], records: Sequence[SensorFile]) -> dict[int, SensorFile]:
    """Return the picture of each sweep by frame index; cameras are slower than the LiDAR, so many have none.

    A picture of a key frame belongs to the sweep of that key frame, any other one to the sweep that was being measured
    when it was taken. Of two for one sweep the one of the key frame counts, then the one nearer in time.

    Args:
        sweeps: The frames.
        records: The pictures of a camera.
    """
    key_frames = {
        sweep.record.sample: place for place, sweep in enumerate(sweeps) if sweep.record.is_key_frame
    }
    times_ns = np.array([sweep.record.time_ns for sweep in sweeps], dtype=np.int64)
    period_ns = float(np.median(np.diff(times_ns))) if len(sweeps) > 1 else _PERIOD_NS
    pictures: dict[int, tuple[tuple[bool, int], SensorFile]] = {}
    for record in records:
        of_key_frame = record.is_key_frame and record.sample in key_frames
        place = key_frames[record.sample] if of_key_frame else int(np.searchsorted(times_ns, record.time_ns))
        if place == len(sweeps):
            continue
        away_ns = abs(int(times_ns[place]) - record.time_ns)
        rank = (not of_key_frame, away_ns)
        known = pictures.get(sweeps[place].index)
        if (of_key_frame or away_ns <= _MAX_PERIODS * period_ns) and (known is None or rank < known[0]):
            pictures[sweeps[place].index] = rank, record
    return {index: record for index, (_, record) in pictures.items()}
