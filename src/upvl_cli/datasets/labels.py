"""Who holds human labels, apart from the drives: no stage that makes labels or trains can reach them."""

from __future__ import annotations

from typing import Protocol

from upvl_cli.types import Array, Bools, Ints, Labels


class LabelSource(Protocol):
    """Human boxes of the same segments; only `upvl eval` opens them."""

    def labels(self, segment: str) -> Labels:
        """All boxes of a segment; raises `BadInput` where it has none."""

    def frames(self, segment: str) -> Ints:
        """(n,) indices of the labelled frames; in the others a box is neither right nor wrong.

        Raises `BadInput` where the drive has no labels.
        """

    def covers(self, segment: str, xyz_ego_m: Array) -> Bools:
        """(n,) whether each place lies where objects were labelled, for example in the front view."""
