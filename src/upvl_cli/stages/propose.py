"""Objects of each sweep, before they are tracked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from upvl_cli.rows import BoxRow
from upvl_cli.stage import Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


LOOK = 3  # values of a feature that clusters go by: more only add noise to the distance


@dataclass(frozen=True)
class ProposeParams:
    """Settings of `propose`."""

    eps_m: float = param("neighbours are closer than this", "m", least=0.05, most=20)
    eps_deg: float = param("or than this, as the car sees them", "degrees", least=0, most=20)
    eps_mps: float = param("and their motion differs by less than this", "m/s", least=0.01, most=1000)
    min_points: int = param(
        "points that make a dense neighbourhood, and the fewest of an object", least=1, most=10**6
    )
    voxel_m: float = param("points closer than this count as one place", "m", least=0.01, most=10)
    eps_vl: float = param(
        "and their features by less than this; 0 takes no notice of features", least=0, most=10
    )
    cluster_background: bool = param(
        "background points make objects too, as in the paper; otherwise they only join what they lie in"
    )
    max_background_share: float = param(
        "drop an object with a larger share of background points: the paper's r_bg", least=0, most=1
    )
    max_lasting_share: float = param(
        "drop an object that claims to leave its place while a larger share of it stays", least=0, most=1
    )
    moving_mps: float = param(
        "from this speed on motion gives the heading, below it shape", "m/s", least=0, most=200
    )
    foot_m: float = param(
        "points lower than this have no say in length, width and heading", "m", least=0, most=10
    )
    person_gap_m: float = param("persons this far apart are not one object", "m", least=0.01, most=20)


@dataclass(frozen=True)
class ProposeRow(BoxRow):
    """Boxes of one sweep, and which points they were made from."""

    box_of_point: Array = column(
        "int32", "number of the box that the point belongs to, -1 for none", per="point"
    )


def run(inputs: Inputs, params: ProposeParams) -> Iterator[ProposeRow]:
    """Cluster the points that move, and fit the tightest box around each cluster."""
    from dataclasses import asdict

    import numpy as np

    from upvl_cli.algorithms.clustering import NOISE
    from upvl_cli.algorithms.persistence import places
    from upvl_cli.algorithms.proposals import Proposals, Sweep, propose
    from upvl_cli.algorithms.views import SEEN
    from upvl_cli.geometry.se3 import apply
    from upvl_cli.parallel import in_order

    drive, settings = inputs.drive, asdict(params)
    eps_vl = settings.pop("eps_vl")
    look_m = params.eps_m / eps_vl if eps_vl else 0.0
    poses = list(inputs.table("odometry"))
    flows, grounds, masks = (inputs.table(name) for name in ("flow", "ground", "mask"))
    features, (fitted,) = inputs.table("extract-vl"), inputs.table("pca")

    def look(frame: int, above: Array) -> Array:
        """The strongest values of the features of points, in metres; 0 where there is none."""
        of = features[frame]
        values = np.zeros((len(above), LOOK))
        values[of.state == SEEN] = fitted.basis.values(of.feature)[:, :LOOK] * look_m
        return values[above]

    def above_ground(pose: Any) -> Array:
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

    for frame, (boxes, box_of_point) in zip(flows.frames, in_order(found, range(len(poses))), strict=True):
        inputs.count("boxes kept", len(boxes.seven))
        for reason, items in boxes.dropped.items():
            inputs.count(reason, items)
        yield ProposeRow(inputs.segment, frame, boxes.seven, boxes.velocity_mps, boxes.points, box_of_point)


STAGE = Stage(
    name="propose",
    run=run,
    params=ProposeParams,
    row=ProposeRow,
    reads=("raw", "odometry", "ground", "flow", "pca", "extract-vl", "mask"),
    version=3,
)
