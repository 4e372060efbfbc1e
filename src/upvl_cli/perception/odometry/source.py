"""What some drives know beside their points: where each was before the motion of the car was compensated."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from upvl_cli.types import Points


@runtime_checkable
class UncompensatedSweeps(Protocol):
    """A drive that can give its sweeps as they were measured, each point in the ego axes of its own moment."""

    def measured_points(self, frame: int) -> Points | None:
        """Return the sweep of a frame as it was measured; None where its files hold compensated points alone.

        Args:
            frame: Index of the frame.
        """
