"""Scores of scene flow, where a dataset knows the true motion of points."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.flow_truth import FLOW_CLASSES
from upvl_cli.datasets.label_registry import FlowSource, flow_source
from upvl_cli.errors import BadInput
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.flow_objects import labelled_flow_score
from upvl_cli.evaluation.gather import fresh_table
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.metrics.flow import DYNAMIC_M, FlowErrors, bucket_score, flow_buckets, flow_errors
from upvl_cli.metrics.flow_objects import ObjectFlowScore
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import FlowRow, OdometryRow
from upvl_cli.types import Array, ParallelArrays, array, concat, empty


@dataclass(frozen=True)
class ClassFlow:
    """Speed-normalised score of one class; NaN where no point counts.

    Attributes:
        name: The class.
        static_epe_m: Mean error of points slower than 0.4 m/s.
        dynamic_error: End-point error as a share of the true displacement; 1 for a prediction of no motion.
    """

    name: str
    static_epe_m: float
    dynamic_error: float


@dataclass(frozen=True)
class FlowScore:
    """Errors over the points of all sweeps that have a next one.

    Attributes:
        errors: Three-way errors as Argoverse 2 defines them; every point weighs the same.
        classes: Speed-normalised errors by class.
        mean_dynamic_error: Mean of the dynamic errors over classes; the challenge ranks methods by it.
        objects: Score of the labelled objects; None where there are no labels.
    """

    errors: FlowErrors
    classes: tuple[ClassFlow, ...]
    mean_dynamic_error: float
    objects: ObjectFlowScore | None


@dataclass(frozen=True)
class _Flow(ParallelArrays):
    """Motion of points over the interval to the next sweep, in ego axes."""

    predicted_m: Array = array("float64", 3)
    true_m: Array = array("float64", 3)
    true_total_m: Array = array("float64", 3)
    flow_class: Array = array("int64")


def flow_score(
    workspace: Workspace, settings: EvalConfig, segments: Collection[str] = ()
) -> FlowScore | None:
    """Return the errors of the flow of all drives; None for a dataset that does not know the true flow.

    Args:
        workspace: The workspace whose flow is scored.
        settings: Half side of the square whose points count.
        segments: Names of the drives; empty takes all.

    Raises:
        NotMade: A drive has no flow, or it was made with other settings.
    """
    source = flow_source(workspace.raw.dataset, workspace.root, workspace.dataset)
    if source is None:
        return None
    pairs = [
        pair for name in segments or workspace.segments for pair in _pairs(workspace, source, name, settings)
    ]
    points = concat([flow for flow, _ in pairs], _Flow)
    errors = flow_errors(
        points.predicted_m,
        points.true_m,
        true_total_m=points.true_total_m,
        foreground=points.flow_class > 0,
        dynamic=np.linalg.norm(points.true_m, axis=1) >= DYNAMIC_M,
        evaluated=points.flow_class >= 0,
    )
    buckets = [
        flow_buckets(
            flow.predicted_m,
            flow.true_m,
            group=flow.flow_class,
            groups=len(FLOW_CLASSES),
            interval_s=interval_s,
        )
        for flow, interval_s in [(empty(_Flow), 1.0), *pairs]
    ]
    score = bucket_score(sum(buckets[1:], buckets[0]))
    by_class = zip(FLOW_CLASSES, score.static_epe_m.tolist(), score.dynamic_error.tolist(), strict=True)
    classes = tuple(ClassFlow(*row) for row in by_class)
    try:
        objects = labelled_flow_score(workspace, settings, segments)
    except BadInput:  # a dataset may know the true flow and have no labels
        objects = None
    return FlowScore(errors, classes, score.mean_dynamic_error, objects)


def _pairs(
    workspace: Workspace, source: FlowSource, segment: str, settings: EvalConfig
) -> Iterator[tuple[_Flow, float]]:
    """Yield the points that count of each sweep with a next one, and the seconds until that one."""
    table = fresh_table(workspace, "flow", FlowRow, segment)
    poses = list(fresh_table(workspace, "odometry", OdometryRow, segment))
    drive = workspace.drive(segment)
    for pose, following in zip(poses, poses[1:], strict=False):
        interval_s = (following.time_ns - pose.time_ns) / 1e9
        xyz_ego_m = drive.points(pose.frame).xyz_ego_m.astype(np.float64)
        truth = source.flow(segment, pose.frame)
        true_m = truth.velocity_mps * interval_s
        next_from_ego = inverse(following.world_from_ego) @ pose.world_from_ego
        flow = _Flow(
            predicted_m=table[pose.frame].flow_mps.astype(np.float64) * interval_s,
            true_m=true_m,
            true_total_m=apply(next_from_ego, xyz_ego_m + true_m) - xyz_ego_m,
            flow_class=truth.flow_class,
        )
        in_square = (np.abs(xyz_ego_m[:, :2]) < settings.flow_reach_m).all(axis=1)
        yield flow[in_square & (truth.flow_class >= 0)], interval_s
