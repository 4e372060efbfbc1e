"""What the auto labels look like: the features of the points inside of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.rows import ObjectRow
from upvl_cli.stage import Stage

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs


@dataclass(frozen=True)
class DescribeParams:
    """`describe` has no settings."""


def run(inputs: Inputs, params: DescribeParams) -> Iterator[ObjectRow]:
    """Give each auto label the features of its points, so that words can find it before any training.

    Points of the background are left out. A point in two boxes that overlap counts for both.
    """
    import numpy as np

    from upvl_cli.algorithms.objects import of_objects, pooled
    from upvl_cli.geometry.boxes import pairs_inside

    (fitted,) = inputs.table("pca")
    features, masks, labels = (inputs.table(name) for name in ("extract-vl", "mask", "nms"))
    for pose in inputs.table("odometry"):
        row, of = labels[pose.frame], features[pose.frame]
        own, feature = of_objects(of.state, of.feature, masks[row.frame].background)
        looked_at = len(own) and len(row.seven)
        xyz = inputs.drive.points(row.frame).xyz_ego_m[own] if looked_at else np.zeros((0, 3))
        box, point = pairs_inside(xyz, row.seven, margin_m=0.0)
        codes = feature[point]
        inputs.count("labels with features", len(np.unique(box)))
        inputs.count("labels that no camera sees", len(row.seven) - len(np.unique(box)))
        yield ObjectRow(
            inputs.segment,
            row.frame,
            row.seven,
            row.velocity_mps,
            row.points,
            row.score,
            row.track_id,
            time_ns=pose.time_ns,
            of_box=box,
            feature=codes,
            pooled=pooled(box, codes, len(row.seven), fitted.basis),
        )


STAGE = Stage(
    name="describe",
    run=run,
    params=DescribeParams,
    row=ObjectRow,
    reads=("raw", "odometry", "pca", "extract-vl", "mask", "nms"),
    version=2,
)
