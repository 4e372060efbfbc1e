"""Settings of box proposals: what is clustered, what is dropped, and how a box is fitted."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.proposals.frustum_config import FrustumConfig


@dataclass(frozen=True)
class ClusteringConfig(Config):
    """Settings of the joint clustering of position, motion and features (MI-UP, Section 4.2)."""

    eps_m: tuple[float, ...] = setting(
        "radius of the neighborhood in which two points are neighbors: the paper's eps; each value gives a "
        "hypothesis, which is tracked on its own, the first one being number 0",
        "m",
        ge=0.05,
        le=20,
    )
    duplicate_iou: float = setting(
        "shared points of two objects of different hypotheses, over the points of both together, from which on "
        "the later one is a duplicate of the earlier one",
        gt=0,
        le=1,
    )
    vertical_eps_m: float = setting(
        "radius of the neighborhood straight up and down, where it is larger than eps_m: glass returns "
        "nothing, and a roof belongs to the doors below its windows",
        "m",
        ge=0.05,
        le=20,
    )
    scale_with_range: bool = setting(
        "let the radius of the neighborhood grow with the distance from the sensor, to angular_eps_deg"
    )
    angular_eps_deg: float = setting(
        "angle between two points, seen from the sensor, up to which they are neighbors although they are "
        "farther apart than eps_m; used with scale_with_range",
        "degrees",
        ge=0,
        le=20,
    )
    use_velocity: bool = setting("let the difference in velocity count between neighbors")
    velocity_eps_mps: float = setting(
        "difference in velocity that counts as much as a distance of eps_m; both add up as the sides of a "
        "right triangle; used with use_velocity",
        "m/s",
        ge=0.01,
        le=200,
    )
    use_vl: bool = setting("let the distance in vision-language features count between neighbors")
    vl_eps: float = setting(
        "difference in features that counts as much as a distance of eps_m; used with use_vl", gt=0, le=10
    )
    vl_dims: int = setting(
        "number of principal components of the features that the distance is made of; used with use_vl",
        ge=1,
        le=64,
    )
    min_points: int = setting(
        "number of points that make a neighborhood dense, and the smallest number of points of an object",
        ge=1,
        le=10**6,
    )
    voxel_m: float = setting(
        "edge of the voxels that points are merged in before they are clustered", "m", ge=0.01, le=10
    )


@dataclass(frozen=True)
class BackgroundFilterConfig(Config):
    """Settings of the background filter (UP-VL, Section 3.2)."""

    cluster: bool = setting(
        "cluster background points too, as in the paper; otherwise they only join a box that they lie in"
    )
    drop: bool = setting("drop objects with too many background points")
    max_share: float = setting(
        "largest share of background among the points of an object whose state is known: the paper's r_bg; "
        "used with drop",
        ge=0,
        le=1,
    )


@dataclass(frozen=True)
class PersistenceConfig(Config):
    """Settings of the persistence filter: a moving object leaves its place empty."""

    max_share: float = setting(
        "largest share of persistent points, whose place is occupied before and after too, among the points "
        "of a moving object",
        ge=0,
        le=1,
    )
    spans_s: tuple[float, ...] = setting(
        "times to look back and ahead; an object takes the shortest one in which it clears its own place",
        "s",
        ge=0.01,
        le=3600,
    )
    clearance_m: float = setting(
        "distance that an object travels beyond its own length until its place counts as cleared",
        "m",
        ge=0,
        le=100,
    )
    voxel_m: float = setting("edge of the voxels that occupied places are stored in", "m", ge=0.01, le=10)
    radius_m: float = setting("distance within which a stored place counts as the same", "m", ge=0.01, le=10)
    time_tolerance: float = setting(
        "share of a span by which the time of a sweep may differ from the time that is asked for", ge=0, le=1
    )


@dataclass(frozen=True)
class ProposalBoxConfig(Config):
    """Settings of the box around the points of one object."""

    moving_mps: float = setting(
        "speed from which the direction of motion is the heading; below it the shape gives the heading",
        "m/s",
        ge=0,
        le=200,
    )
    ground_clearance_m: float = setting(
        "height above the ground below which points (kerbs, ground) do not count for length, width and heading",
        "m",
        ge=0,
        le=10,
    )
    standing_height_m: float = setting(
        "height above the ground below which the lowest point of an object lies if the object stands on the "
        "ground; its box then reaches down to the ground",
        "m",
        ge=0,
        le=100,
    )
    trim: float = setting(
        "share of the points left out at each end of length and width, as stray returns", ge=0, le=0.49
    )
    heading_step_deg: float = setting(
        "step between the headings that are tried for the shape of an object", "degrees", ge=0.01, le=90
    )
    edge_floor_m: float = setting(
        "distance from an edge below which a point is not any closer to it: the noise of the range",
        "m",
        ge=0.001,
        le=10,
    )
    adoption_margin_m: float = setting(
        "distance outside a box up to which a point without a cluster joins it", "m", ge=0, le=10
    )


@dataclass(frozen=True)
class CrowdConfig(Config):
    """Settings of the split of a crowd into persons."""

    gap_m: float = setting("gap between two persons, seen from above", "m", ge=0.01, le=20)
    voxel_m: float = setting("edge of the voxels in which gaps are searched", "m", ge=0.01, le=10)
    min_points: int = setting("number of points that make a neighborhood within gap_m dense", ge=1, le=10**6)
    min_width_m: float = setting(
        "smallest extent of a person seen from above: less is a stripe of a sparsely sampled surface",
        "m",
        ge=0,
        le=10,
    )
    max_width_m: float = setting("largest extent of a person seen from above: a stride", "m", ge=0, le=10)
    min_height_m: float = setting("smallest height of a person", "m", ge=0, le=10)
    max_height_m: float = setting("largest height of a person", "m", ge=0, le=10)
    min_share: float = setting(
        "smallest share of the points of a cluster that its persons hold together; with less the cluster is "
        "one object",
        ge=0,
        le=1,
    )


@dataclass(frozen=True)
class ProposalConfig(Config):
    """Settings of `propose.propose`."""

    clustering: ClusteringConfig = table("joint clustering of position, motion and features")
    background: BackgroundFilterConfig = table("background points and objects of them")
    persistence: PersistenceConfig = table("objects that claim to move but whose place stays occupied")
    box: ProposalBoxConfig = table("the box around the points of an object")
    crowd: CrowdConfig = table("persons who walk close together")
    frustum: FrustumConfig = table("objects that 2D boxes show; used where boxes2d has a detector")
