"""Rows that several stages share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, column

if TYPE_CHECKING:
    from upvl_cli.types import Array, Boxes


@dataclass(frozen=True)
class BoxRow(Row):
    """Boxes of one frame."""

    seven: Array = column(
        "float64",
        "centre x, y, z, length, width, height (m), heading (rad)",
        axes="ego",
        per="box",
        shape=(7,),
    )
    velocity_mps: Array = column("float64", "velocity over the ground", "m/s", "ego", per="box", shape=(3,))
    points: Array = column("int32", "LiDAR points that the box was made from", per="box")


@dataclass(frozen=True)
class LabelRow(BoxRow):
    """Boxes of one frame that are labels: scored and tracked."""

    score: Array = column("float64", "confidence, 0 to 1", per="box")
    track_id: Array = column("int64", "number of the track in its segment", per="box")

    @property
    def boxes(self) -> Boxes:
        """The labels without the key."""
        from upvl_cli.types import Boxes

        return Boxes(self.seven, self.velocity_mps, self.score, self.track_id)


@dataclass(frozen=True)
class ObjectRow(LabelRow):
    """Boxes of one frame with the vision-language features of the points inside of them: what a query reads."""

    time_ns: int = column("int64", "time of the sweep", "ns")
    of_box: Array = column("int32", "place of the box that the point is in, ascending", per="object point")
    feature: Array = column(
        "int8",
        "values of each object point, to be scaled by pca's steps; by box, then in the order of the points",
        per="object point",
        shape=(64,),
    )
    pooled: Array = column(
        "int8",
        "mean feature of each box, rounded in the same way; zeros without points",
        per="box",
        shape=(64,),
    )
