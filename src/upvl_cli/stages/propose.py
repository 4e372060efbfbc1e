"""Objects of each sweep, before they are tracked."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.perception.proposals.config import ProposalConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import Boxes2dRow, ExtractVlRow, PcaRow
from upvl_cli.stages.rows import FlowRow, GroundRow, MaskRow, OdometryRow, ProposalRow

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

    from upvl_cli.perception.proposals.frustum import CameraBoxes
    from upvl_cli.perception.proposals.persistence import OccupancyHistory
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class ProposeConfig(ProposalConfig):
    """Settings of `propose`."""


def run(inputs: Inputs, config: ProposeConfig) -> Iterator[ProposalRow]:
    """Cluster the points that move, and fit the tightest box around each cluster."""
    import numpy as np

    from upvl_cli.perception.proposals.cluster_fits import Sweep
    from upvl_cli.perception.proposals.frustum import frustum_clusters
    from upvl_cli.perception.proposals.hypotheses import HypothesisBoxes, join_hypotheses
    from upvl_cli.perception.proposals.propose import lift, propose
    from upvl_cli.runtime.parallel import in_order

    flows, grounds = inputs.table("flow", FlowRow), inputs.table("ground", GroundRow)
    masks = inputs.table("mask", MaskRow)
    features, (fitted,) = inputs.table("extract-vl", ExtractVlRow), inputs.table("pca", PcaRow)
    pictures_of = _pictures(inputs, config)
    lifted = len(config.clustering.eps_m)  # number of the hypothesis of objects that 2D boxes show

    def proposals(moment: Moment) -> tuple[OdometryRow, HypothesisBoxes, Counter[str]]:
        """Return the pose and the boxes of a frame, and how much was left out, by reason."""
        frame = moment.pose.frame
        flow, ground, mask = flows[frame], grounds[frame], masks[frame]
        above = ~ground.is_ground
        sweep = Sweep(
            xyz_m=moment.above_m.astype(np.float64),
            velocity_mps=flow.flow_mps[above].astype(np.float64),
            is_candidate=mask.is_moving[above],
            background=mask.background[above],
            vl_feature=_vl_feature(features[frame], fitted, config)[above],
            height_m=ground.height_m[above].astype(np.float64),
            world_from_sweep=moment.pose.world_from_ego,
            step=moment.step,
        )
        hypotheses = propose(sweep, moment.history, config)
        dropped = Counter[str]()
        for hypothesis in hypotheses:
            dropped.update(hypothesis.dropped)
        pictures = pictures_of(moment, sweep.velocity_mps)
        if pictures:
            given = [hypothesis.box_of_point for hypothesis in hypotheses]
            label, counts = frustum_clusters(pictures, given, len(sweep.xyz_m), config.frustum)
            hypotheses.append(lift(sweep, label, config))
            dropped.update(counts)
        number = np.flatnonzero(above).astype(np.int32)
        duplicate_iou = config.clustering.duplicate_iou
        return moment.pose, join_hypotheses(hypotheses, number, duplicate_iou=duplicate_iou), dropped

    for pose, found, dropped in in_order(proposals, _moments(inputs, config)):
        inputs.count("boxes kept", len(found.boxes))
        inputs.count("boxes that an earlier hypothesis has too", (found.duplicate_of >= 0).sum())
        for reason, items in dropped.items():
            inputs.count(reason, items)
        yield ProposalRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            *(found.boxes.center_m, found.boxes.size_lwh_m, found.boxes.heading_rad),
            found.velocity_mps,
            found.num_points,
            found.hypothesis,
            found.duplicate_of,
            found.point_index,
            is_lifted=found.hypothesis == lifted,
        )


@dataclass(frozen=True)
class Moment:
    """A frame, and the occupied places in the seconds around it.

    Attributes:
        pose: Its pose.
        above_m: (n, 3) its points that stand above the ground, in ego axes.
        step: Its number in the history.
        history: Occupied places before, in and after the frame.
    """

    pose: OdometryRow
    above_m: Array
    step: int
    history: OccupancyHistory


def _moments(inputs: Inputs, config: ProposeConfig) -> Iterator[Moment]:
    """Yield the frames, each with the sweeps in the reach of `persistence.spans_s`: no more of them are held."""
    import numpy as np

    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.odometry.compensation import compensated_points
    from upvl_cli.perception.proposals.persistence import occupied_places, sliding_history
    from upvl_cli.runtime.parallel import in_order

    poses = inputs.table("odometry", OdometryRow)
    points_of = compensated_points(inputs.drive, poses)
    grounds = inputs.table("ground", GroundRow)
    coming: deque[tuple[OdometryRow, Array]] = deque()

    def occupied(pose: OdometryRow) -> tuple[OdometryRow, Array, cKDTree]:
        """Return the points of a frame above the ground, in ego axes, and the places that they occupy."""
        above_m = points_of(pose.frame).xyz_ego_m[~grounds[pose.frame].is_ground]
        world_m = apply(pose.world_from_ego, above_m.astype(np.float64))
        return pose, above_m, occupied_places(world_m, voxel_m=config.persistence.voxel_m)

    def trees() -> Iterator[cKDTree]:
        for pose, above_m, tree in in_order(occupied, poses):
            coming.append((pose, above_m))
            yield tree

    time_ns = [pose.time_ns for pose in poses]
    time_s = np.array([(time - time_ns[0]) * 1e-9 for time in time_ns])
    for step, history in sliding_history(time_s, trees(), config.persistence):
        yield Moment(*coming.popleft(), step, history)


def _pictures(inputs: Inputs, config: ProposeConfig) -> Callable[[Moment, Floats], list[CameraBoxes]]:
    """Return the function of a frame and its points' flow that gives its pictures with boxes of people."""
    import numpy as np

    from upvl_cli.geometry.path import pose_at
    from upvl_cli.perception.proposals.frustum import CameraBoxes
    from upvl_cli.perception.visual.riders import merge_riders
    from upvl_cli.perception.visual.views import move_to_time

    cameras, boxes2d = inputs.drive.cameras, inputs.table("boxes2d", Boxes2dRow)
    poses = list(inputs.table("odometry", OdometryRow))
    times_ns, world_from_ego = [pose.time_ns for pose in poses], [pose.world_from_ego for pose in poses]

    def pictures(moment: Moment, velocity_mps: Floats) -> list[CameraBoxes]:
        row, found = boxes2d[moment.pose.frame], list[CameraBoxes]()
        for number in np.unique(row.camera).tolist():
            boxes = merge_riders(row.boxes2d[row.camera == number])
            boxes = boxes[
                np.isin(boxes.name, config.frustum.kinds) & (boxes.score >= config.frustum.min_score)
            ]
            if len(boxes):
                time_ns = int(row.image_time_ns[number])
                xyz_m = move_to_time(
                    moment.above_m.astype(np.float64),
                    velocity_mps,
                    (time_ns - moment.pose.time_ns) * 1e-9,
                    moment.pose.world_from_ego,
                    pose_at(times_ns, np.array(world_from_ego), time_ns),
                )
                found.append(CameraBoxes(cameras[number], xyz_m, boxes))
        return found

    return pictures


def _vl_feature(row: ExtractVlRow, fitted: PcaRow, config: ProposeConfig) -> Floats:
    """Return (n, d) strongest components of the features of points, 0 where there is none; d = 0 without features."""
    import numpy as np

    from upvl_cli.perception.visual.views import SEEN

    if not config.clustering.use_vl:
        return np.zeros((len(row.state), 0))
    values: Floats = np.zeros((len(row.state), config.clustering.vl_dims), dtype=np.float32)
    values[row.state == SEEN] = fitted.basis.dequantize(row.feature)[:, : config.clustering.vl_dims]
    return values


STAGE = Stage(
    name="propose",
    run=run,
    config=ProposeConfig,
    row=ProposalRow,
    reads=("raw", "odometry", "ground", "flow", "pca", "extract-vl", "mask", "boxes2d"),
    version=5,
)
