"""Vision-language features of the auto labels: those of the points inside of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, LooksRow, PcaRow
from upvl_cli.stages.rows import AmodalRow, MaskRow, ObjectRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class PoolFeaturesConfig(Config):
    """`pool-features` has no settings."""


def run(inputs: Inputs, config: PoolFeaturesConfig) -> Iterator[ObjectRow]:
    """Give each auto label the features of its points, so that words can find it before any training.

    Points of the background are left out. A point in two boxes that overlap counts for both. Beside them stands the
    mean feature of the looks at the label's track.
    """
    import numpy as np

    from upvl_cli.geometry.boxes import pairs_inside
    from upvl_cli.perception.labels.point_features import average_pool, foreground_points
    from upvl_cli.types import Ragged

    (fitted,) = inputs.table("pca", PcaRow)
    features, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    looks = inputs.table("looks", LooksRow)
    labels = inputs.table("nms", AmodalRow)
    for row in (labels[frame] for frame in labels.frames if frame in inputs.window):
        seen = features[row.frame]
        point, feature = foreground_points(seen.state, seen.feature, masks[row.frame].background)
        total = len(row.boxes)
        xyz_m = np.zeros((0, 3))
        if len(point) and total:
            xyz_m = inputs.drive.points(row.frame).xyz_ego_m[point]
        box, inside = pairs_inside(xyz_m, row.boxes, margin_m=0.0)
        point_feature = Ragged.grouped(box, feature[inside], total)
        has_features = int(np.count_nonzero(point_feature.count))
        inputs.count("labels with features", has_features)
        inputs.count("labels that no camera sees", total - has_features)
        seen_by_looks = looks[row.frame]
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
            num_features=point_feature.count,
            point_feature=point_feature,
            pooled=average_pool(point_feature, fitted.basis),
            num_looks=seen_by_looks.num_looks,
            look_feature=seen_by_looks.look_feature,
        )


STAGE = Stage(
    name="pool-features",
    run=run,
    config=PoolFeaturesConfig,
    row=ObjectRow,
    reads=("raw", "pca", "extract-vl", "mask", "nms", "looks"),
    windowed=True,
    version=2,
)
