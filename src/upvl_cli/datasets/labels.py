"""Who holds human labels, apart from the drives: no stage that makes labels or trains can reach them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from upvl_cli.types import Array, Bools, Boxes, Ints, Labels


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


@runtime_checkable
class UnlabelledZones(Protocol):
    """A source of labels that knows zones which people left without labels."""

    def unlabelled(self, segment: str, frame: int, boxes: Boxes) -> Bools:
        """(n,) whether each box, in the ego axes of the frame, overlaps such a zone: it is no false positive."""
