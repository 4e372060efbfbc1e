"""Objects of each sweep, before they are tracked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, GroundRow, MaskRow, OdometryRow, PcaRow, ProposalRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array


LOOK = 3  # values of a feature that clusters go by: more only add noise to the distance


@dataclass(frozen=True)
class ProposeConfig(Config):
    """Settings of `propose`."""

    eps_m: float = setting("neighbours are closer than this", "m", ge=0.05, le=20)
    eps_deg: float = setting("or than this, as the car sees them", "degrees", ge=0, le=20)
    eps_mps: float = setting("and their motion differs by less than this", "m/s", ge=0.01, le=1000)
    min_points: int = setting(
        "points that make a dense neighbourhood, and the fewest of an object", ge=1, le=10**6
    )
    voxel_m: float = setting("points closer than this count as one place", "m", ge=0.01, le=10)
    eps_vl: float = setting(
        "and their features by less than this; 0 takes no notice of features", ge=0, le=10
    )
    cluster_background: bool = setting(
        "background points make objects too, as in the paper; otherwise they only join what they lie in"
    )
    max_background_share: float = setting(
        "drop an object with a larger share of background points: the paper's r_bg", ge=0, le=1
    )
    max_lasting_share: float = setting(
        "drop an object that claims to leave its place while a larger share of it stays", ge=0, le=1
    )
    moving_mps: float = setting(
        "from this speed on motion gives the heading, below it shape", "m/s", ge=0, le=200
    )
    foot_m: float = setting(
        "points lower than this have no say in length, width and heading", "m", ge=0, le=10
    )
    person_gap_m: float = setting("persons this far apart are not one object", "m", ge=0.01, le=20)


def run(inputs: Inputs, config: ProposeConfig) -> Iterator[ProposalRow]:
    """Cluster the points that move, and fit the tightest box around each cluster."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.geometry.se3 import apply
    from upvl_cli.perception.clustering import NOISE
    from upvl_cli.perception.proposals.persistence import places
    from upvl_cli.perception.proposals.propose import Proposals, Sweep, propose
    from upvl_cli.perception.visual.views import SEEN
    from upvl_cli.runtime.parallel import in_order
    from upvl_cli.types import Boxes, Ragged

    drive, settings = inputs.drive, asdict(config)
    eps_vl = settings.pop("eps_vl")
    look_m = config.eps_m / eps_vl if eps_vl else 0.0
    poses = list(inputs.table("odometry", OdometryRow))
    flows, grounds = inputs.table("flow", FlowRow), inputs.table("ground", GroundRow)
    masks = inputs.table("mask", MaskRow)
    features, (fitted,) = inputs.table("extract-vl", ExtractVlRow), inputs.table("pca", PcaRow)

    def look(frame: int, above: Array) -> Array:
        """The strongest values of the features of points, in metres; 0 where there is none."""
        of = features[frame]
        values = np.zeros((len(above), LOOK))
        values[of.state == SEEN] = fitted.basis.dequantize(of.feature)[:, :LOOK] * look_m
        return values[above]

    def above_ground(pose: OdometryRow) -> Array:
        """The points of a frame that stand above the ground, in ego axes."""
        is_ground: Array = grounds[pose.frame].is_ground
        return drive.points(pose.frame).xyz_ego_m[~is_ground].astype(np.float64)

    # Kept for the whole drive: each sweep is looked at from seconds before and after.
    above_m = list(in_order(above_ground, poses))
    world_m = (apply(pose.world_from_ego, xyz_m) for pose, xyz_m in zip(poses, above_m, strict=True))
    taken = places(np.array([(pose.time_ns - poses[0].time_ns) * 1e-9 for pose in poses]), world_m)

    def found(step: int) -> tuple[Proposals, Array]:
        """The boxes of a frame, and which of its points belong to them."""
        frame = poses[step].frame
        flow, ground, mask = flows[frame], grounds[frame], masks[frame]
        above = ~ground.is_ground
        sweep = Sweep(
            above_m[step],
            flow.flow_mps[above].astype(np.float64),
            mask.is_moving[above],
            mask.background[above],
            look(frame, above) if look_m else np.zeros((above.sum(), 0)),
            ground.height_m[above].astype(np.float64),
            poses[step].world_from_ego,
            step,
        )
        boxes = propose(sweep, taken, **settings)
        box_of_point = np.full(len(above), NOISE)
        box_of_point[above] = boxes.of_point
        return boxes, box_of_point

    for pose, (found_here, box_of_point) in zip(poses, in_order(found, range(len(poses))), strict=True):
        boxes = Boxes.from_rows(found_here.seven)
        inputs.count("boxes kept", len(boxes))
        for reason, items in found_here.dropped.items():
            inputs.count(reason, items)
        yield ProposalRow(
            inputs.segment,
            pose.frame,
            pose.time_ns,
            boxes.center_m,
            boxes.size_lwh_m,
            boxes.heading_rad,
            found_here.velocity_mps,
            found_here.points,
            Ragged.grouped(box_of_point, np.arange(len(box_of_point), dtype=np.int32), len(boxes)),
        )


STAGE = Stage(
    name="propose",
    run=run,
    config=ProposeConfig,
    row=ProposalRow,
    reads=("raw", "odometry", "ground", "flow", "pca", "extract-vl", "mask"),
    version=3,
)
