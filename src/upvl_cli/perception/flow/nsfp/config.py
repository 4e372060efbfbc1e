"""Settings of NSFP and NSFP++; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.flow.config import FlowSurfaceConfig, FlowVoteConfig

_DEVICES = {
    "cpu": "one thread for each pair of sweeps",
    "cuda": "the first GPU; its sums differ from those of the CPU in the last digits",
}


@dataclass(frozen=True)
class FlowNetworkConfig(Config):
    """The network that maps a position to a flow: a perceptron with ReLU."""

    hidden_layers: int = setting("hidden layers of the network", ge=1, le=32)
    width: int = setting("neurons of each hidden layer", ge=1, le=1024)
    seed: int = setting("seed of the initial weights", ge=0, le=2**31 - 1)


@dataclass(frozen=True)
class FlowOptimizerConfig(Config):
    """Optimisation of a network by Adam, and its loss."""

    learning_rate: float = setting("learning rate of Adam", gt=0, le=1)
    weight_decay: float = setting("weight decay (L2 penalty) of Adam", ge=0, le=1)
    max_iterations: int = setting("iterations at most", ge=1, le=10**6)
    patience: int = setting("iterations without a lower loss after which a network is done", ge=1, le=10**6)
    min_improvement: float = setting(
        "improvement of the loss that counts for `patience`", "m^2", ge=0, le=100
    )
    max_distance_m: float = setting(
        "distance from which a point's nearest-neighbour term of the Chamfer distance is constant",
        "m",
        gt=0,
        le=100,
    )
    backward: bool = setting(
        "true: a second network takes the moved points back to where they were; false: the forward network alone"
    )


@dataclass(frozen=True)
class NsfpFlowConfig(Config):
    """NSFP: one network for the entire sweep."""

    device: Literal["cpu", "cuda"] = setting("what computes", effects=_DEVICES)
    max_points: int = setting(
        "points of each sweep that are optimised at most; the network then gives the flow of all",
        ge=2,
        le=10**7,
    )
    network: FlowNetworkConfig = table("the network")
    optimizer: FlowOptimizerConfig = table("optimisation of the network")


@dataclass(frozen=True)
class StaticPointsConfig(Config):
    """Which points are judged static, and get no flow, before components are made."""

    method: Literal["none", "points", "components"] = setting(
        "how static points are found",
        effects={
            "none": "no point is judged static",
            "points": "a point is static where a point of the other sweep is nearer than `max_distance_m`",
            "components": "the points of both sweeps are clustered together, and a cluster is static where its "
            "misfit to the other sweep is at most `max_misfit`",
        },
    )
    max_distance_m: float = setting(
        'distance to the other sweep up to which a point is static, for method = "points"', "m", ge=0, le=10
    )
    max_misfit: float = setting(
        'mean misfit to the other sweep, in point spacings, up to which a cluster is static, for method = "components"',
        ge=0,
        le=100,
    )
    screen_points: int = setting(
        'points of each cluster that are tested at most, for method = "components"', ge=1, le=10**6
    )
    target: bool = setting(
        "true: static points of the other sweep are left out of the box query; false: all are candidates"
    )


@dataclass(frozen=True)
class FlowComponentsConfig(Config):
    """Connected components by DBSCAN; points of none (noise) get no flow."""

    eps_m: float = setting("radius of the DBSCAN neighborhood", "m", ge=0.05, le=20)
    min_points: int = setting("points within `eps_m` that make a DBSCAN neighborhood dense", ge=1, le=10**6)
    voxel_m: float = setting("edge of the voxels whose centroids DBSCAN clusters", "m", ge=0.01, le=10)


@dataclass(frozen=True)
class BoxQueryConfig(Config):
    """Which points of the other sweep a component may correspond to."""

    max_speed_mps: float = setting(
        "fastest motion: the bird's-eye box of a component grows by this times the interval at each end",
        "m/s",
        gt=0,
        le=80,
    )
    short_side: Literal["equal", "proportional"] = setting(
        "how the short side of the box grows",
        effects={
            "equal": "as the long side: a rear seen alone moves along its short side",
            "proportional": "less than the long side, by the ratio of the two",
        },
    )
    prune: bool = setting(
        "true: of the points in the box only the n nearest to the component's mean at its start are kept, "
        "n = min(source, target) - 1; false: all are kept"
    )
    min_points: int = setting(
        "points of the other sweep below which a component gets no flow", ge=1, le=10**6
    )


@dataclass(frozen=True)
class FlowConsistencyConfig(Config):
    """Local consistency: the points of a component move alike."""

    weight: float = setting(
        "weight of the mean distance between the flows of two points of a component; 0 leaves the term out",
        "m",
        ge=0,
        le=1000,
    )
    radius_m: float = setting(
        "pairs of points farther apart do not count: what turns, or swings its arms, moves alike only locally",
        "m",
        gt=0,
        le=1000,
    )
    points: int = setting(
        "points of a component that all its points are compared with; all pairs would grow with the square",
        ge=1,
        le=10**4,
    )


@dataclass(frozen=True)
class NsfpPlusPlusConfig(Config):
    """NSFP++: a network for each connected component that moves (MI-UP, section 4.1)."""

    device: Literal["cpu", "cuda"] = setting("what computes", effects=_DEVICES)
    max_points: int = setting(
        "points of a component that are optimised at most; its network then gives the flow of all",
        ge=2,
        le=10**6,
    )
    max_target_points: int = setting(
        "points of the other sweep that a component is compared with at most", ge=2, le=10**6
    )
    max_batch: int = setting(
        "components that are optimised as one batch at most, which bounds the memory", ge=1, le=10**5
    )
    start: Literal["rest", "centroid", "vote"] = setting(
        "displacement from which the optimisation of a component starts",
        effects={
            "rest": "none",
            "centroid": "from the mean of the component to that of the points in its box",
            "vote": "of rest, that shift and the peaks of a displacement histogram, the one that brings the "
            "component nearest to the other sweep",
        },
    )
    min_gain: float = setting(
        "share by which the flow must lower the component's distance to the other sweep, else it stands; "
        "0 keeps every flow",
        ge=0,
        le=1,
    )
    static: StaticPointsConfig = table("points that are judged static")
    surface: FlowSurfaceConfig = table('misfit of clusters at rest, for static.method = "components"')
    components: FlowComponentsConfig = table("connected components")
    query: BoxQueryConfig = table("points of the other sweep in the expanded box of a component")
    vote: FlowVoteConfig = table('displacement histogram, for start = "vote"')
    network: FlowNetworkConfig = table("the network of a component")
    optimizer: FlowOptimizerConfig = table("optimisation of the networks")
    consistency: FlowConsistencyConfig = table("local consistency of the flow inside a component")
