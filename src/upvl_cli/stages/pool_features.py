"""What the auto labels look like: the features of the points inside of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, ExtractVlRow, MaskRow, ObjectRow, PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class PoolFeaturesConfig(Config):
    """`pool-features` has no settings."""


def run(inputs: Inputs, config: PoolFeaturesConfig) -> Iterator[ObjectRow]:
    """Give each auto label the features of its points, so that words can find it before any training.

    Points of the background are left out. A point in two boxes that overlap counts for both.
    """
    import numpy as np

    from upvl_cli.geometry.boxes import pairs_inside
    from upvl_cli.perception.labels.point_features import of_objects, pooled
    from upvl_cli.types import Ragged

    (fitted,) = inputs.table("pca", PcaRow)
    features, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    labels = inputs.table("nms", AmodalRow)
    for row in labels:
        of = features[row.frame]
        own, feature = of_objects(of.state, of.feature, masks[row.frame].background)
        total = len(row.track_id)
        looked_at = len(own) and total
        xyz = inputs.drive.points(row.frame).xyz_ego_m[own] if looked_at else np.zeros((0, 3))
        box, point = pairs_inside(xyz, row.boxes, margin_m=0.0)
        codes = feature[point]
        inputs.count("labels with features", len(np.unique(box)))
        inputs.count("labels that no camera sees", total - len(np.unique(box)))
        yield ObjectRow(
            inputs.segment,
            row.frame,
            row.time_ns,
            row.center_m,
            row.size_lwh_m,
            row.heading_rad,
            row.velocity_mps,
            row.num_points,
            row.score,
            row.track_id,
            num_features=np.bincount(box, minlength=total),
            point_feature=Ragged.grouped(box, codes, total),
            pooled=pooled(box, codes, total, fitted.basis),
        )


STAGE = Stage(
    name="pool-features",
    run=run,
    config=PoolFeaturesConfig,
    row=ObjectRow,
    reads=("raw", "pca", "extract-vl", "mask", "nms"),
    version=2,
)
