"""Objects of each sweep, before they are tracked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.perception.proposals.config import ProposalConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, GroundRow, MaskRow, OdometryRow, PcaRow, ProposalRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Floats, Ints


@dataclass(frozen=True)
class ProposeConfig(ProposalConfig):
    """Settings of `propose`."""


def run(inputs: Inputs, config: ProposeConfig) -> Iterator[ProposalRow]:
    """Cluster the points that move, and fit the tightest box around each cluster."""
    import numpy as np

    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.clustering import NOISE
    from upvl_cli.perception.proposals.persistence import OccupancyHistory
    from upvl_cli.perception.proposals.propose import Proposals, Sweep, propose
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import Ragged

    drive = inputs.drive
    poses = list(inputs.table("odometry", OdometryRow))
    flows, grounds = inputs.table("flow", FlowRow), inputs.table("ground", GroundRow)
    masks = inputs.table("mask", MaskRow)
    features, (fitted,) = inputs.table("extract-vl", ExtractVlRow), inputs.table("pca", PcaRow)

    def points_above_ground(pose: OdometryRow) -> Array:
        """Return the points of a frame that stand above the ground, in ego axes."""
        is_ground: Array = grounds[pose.frame].is_ground
        return drive.points(pose.frame).xyz_ego_m[~is_ground].astype(np.float64)

    # Kept for the whole drive: the persistence of each sweep is measured seconds before and after.
    above_m = list(in_order(points_above_ground, poses))
    world_m = (apply(pose.world_from_ego, xyz_m) for pose, xyz_m in zip(poses, above_m, strict=True))
    time_s = np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses])
    history = OccupancyHistory.from_sweeps(time_s, world_m, voxel_m=config.persistence.voxel_m)

    def proposals(step: int) -> tuple[Proposals, Ints]:
        """Return the boxes of a frame, and the box of each of its points, -1 for none."""
        frame = poses[step].frame
        flow, ground, mask = flows[frame], grounds[frame], masks[frame]
        above = ~ground.is_ground
        sweep = Sweep(
            xyz_m=above_m[step],
            velocity_mps=flow.flow_mps[above].astype(np.float64),
            is_candidate=mask.is_moving[above],
            background=mask.background[above],
            vl_feature=_vl_feature(features[frame], fitted, config)[above],
            height_m=ground.height_m[above].astype(np.float64),
            world_from_sweep=poses[step].world_from_ego,
            step=step,
        )
        found = propose(sweep, history, config)
        box_of_point: Ints = np.full(len(above), NOISE)
        box_of_point[above] = found.box_of_point
        return found, box_of_point

    for pose, (found, box_of_point) in zip(poses, in_order(proposals, range(len(poses))), strict=True):
        inputs.count("boxes kept", len(found.boxes))
        for reason, items in found.dropped.items():
            inputs.count(reason, items)
        points: Ints = np.arange(len(box_of_point), dtype=np.int32)
        yield ProposalRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            *(found.boxes.center_m, found.boxes.size_lwh_m, found.boxes.heading_rad),
            found.velocity_mps,
            found.num_points,
            Ragged.grouped(box_of_point, points, len(found.boxes)),
        )


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
    reads=("raw", "odometry", "ground", "flow", "pca", "extract-vl", "mask"),
    version=3,
)
