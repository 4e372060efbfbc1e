"""The stages, in the order in which they run."""

from __future__ import annotations

from upvl_cli.stage import Stage
from upvl_cli.stages import (
    amodal,
    describe,
    detect,
    extract_vl,
    flow,
    ground,
    mask,
    name,
    nms,
    odometry,
    pca,
    propose,
    track,
    train,
)

# Those that make labels.
LABELLING: tuple[Stage, ...] = (
    odometry.STAGE,
    ground.STAGE,
    flow.STAGE,
    pca.STAGE,
    extract_vl.STAGE,
    mask.STAGE,
    propose.STAGE,
    track.STAGE,
    amodal.STAGE,
    nms.STAGE,
    name.STAGE,
    describe.STAGE,
)

# Those that learn from labels, and find without a picture.
DETECTING: tuple[Stage, ...] = (train.STAGE, detect.STAGE)

STAGES: tuple[Stage, ...] = (*LABELLING, *DETECTING)

BY_NAME: dict[str, Stage] = {stage.name: stage for stage in STAGES}
