"""Times of frames: ascending, and by order or by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Frame

MIN_STEP_NS = 1_000_000  # no LiDAR makes a thousand sweeps a second; speeds are divided by this
MAX_SPAN_H = 24.0  # one drive lasts minutes or hours


def check_frames(frames: Sequence[Frame], where: object) -> tuple[Frame, ...]:
    """Return the frames of a drive.

    Args:
        frames: The frames, in ascending order of index.
        where: The file that holds their times, for the message.

    Raises:
        BadInput: One is not at least a millisecond later than the one before, or they span more than a day.
    """
    index = np.array([frame.index for frame in frames], dtype=np.int64)
    time_ns = [frame.time_ns for frame in frames]
    if len(frames) and max(map(abs, time_ns)) >= 2**62:
        raise BadInput(f"{where}: a time of {max(time_ns, key=abs)} ns is out of range; mend it")
    late = np.diff(np.array(time_ns, dtype=np.int64)) < MIN_STEP_NS
    if (np.diff(index) <= 0).any():
        step = int(np.flatnonzero(np.diff(index) <= 0)[0])
        raise BadInput(
            f"{where}: frame {index[step + 1]} comes after frame {index[step]}, expected ascending numbers"
        )
    if late.any():
        step = int(np.flatnonzero(late)[0])
        later_ns = time_ns[step + 1] - time_ns[step]
        how = f"only {later_ns} ns" if later_ns > 0 else "not"
        raise BadInput(
            f"{where}: frame {index[step + 1]} is {how} later than frame {index[step]}, expected ascending times; "
            "mend its time"
        )
    if len(frames) and (time_ns[-1] - time_ns[0]) / 3.6e12 > MAX_SPAN_H:
        hours = (time_ns[-1] - time_ns[0]) / 3.6e12
        raise BadInput(
            f"{where}: frames {index[0]} and {index[-1]} are {hours:.0f} hours apart, expected less than "
            f"{MAX_SPAN_H:g} in one drive; check the unit of its times"
        )
    return tuple(frames)
