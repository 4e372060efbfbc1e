"""The stages, in the order in which they run."""

from __future__ import annotations

from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.stages import (
    amodal,
    boxes2d,
    classify,
    detect,
    extract_vl,
    flow,
    ground,
    labels,
    looks,
    mask,
    match_boxes2d,
    nms,
    odometry,
    pca,
    pool_features,
    propose,
    semantics,
    track,
    train,
)

STAGES: tuple[AnyStage, ...] = (
    odometry.STAGE,
    ground.STAGE,
    flow.STAGE,
    pca.STAGE,
    extract_vl.STAGE,
    mask.STAGE,
    boxes2d.STAGE,
    propose.STAGE,
    track.STAGE,
    amodal.STAGE,
    nms.STAGE,
    looks.STAGE,
    match_boxes2d.STAGE,
    classify.STAGE,
    labels.STAGE,
    pool_features.STAGE,
    semantics.STAGE,
    train.STAGE,
    detect.STAGE,
)

# What makes labels; the other stages learn from labels, and find without a picture.
LABELLING: tuple[str, ...] = (
    "odometry",
    "ground",
    "flow",
    "pca",
    "extract-vl",
    "mask",
    "boxes2d",
    "propose",
    "track",
    "amodal",
    "nms",
    "looks",
    "match-boxes2d",
    "classify",
    "labels",
    "pool-features",
)
