"""Settings of the flow methods; imports nothing heavy, so that `upvl --help` stays quick."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class FlowSurfaceConfig(Config):
    """How the surface around a point is estimated, and how a misfit to the other sweep is measured against it."""

    neighbors: int = setting(
        "nearest neighbors of a point in its own sweep that give the spacing and the normal of its surface",
        ge=3,
        le=100,
    )
    neighbor_radius_m: float = setting(
        "neighbors farther from a point than this are left out of its surface estimate", "m", ge=0.05, le=100
    )
    range_noise_m: float = setting(
        "range noise of the LiDAR, added to the point spacing that a misfit is measured in", "m", gt=0, le=1
    )
    max_flatness: float = setting(
        "smallest eigenvalue of a neighborhood's covariance, as a share of the middle one, below which it is a plane",
        gt=0,
        le=1,
    )
    normal_error: float = setting(
        "sine of the typical error of an estimated normal: less motion across a plane is not observable",
        ge=0,
        le=1,
    )
    max_distance_m: float = setting(
        "distance at which a misfit is cut off, and that of a point without a partner", "m", ge=0.05, le=20
    )
    spacing_points: int = setting(
        "points of a sweep at which its spacing is measured, roughly", ge=1, le=10**6
    )
    spacing_quantile: float = setting(
        "share of these points that lie denser than what counts as the finest spacing of the sensor",
        ge=0,
        le=1,
    )
    max_misfit: float = setting("point spacings at which the misfit of one point is cut off", gt=0, le=1000)


@dataclass(frozen=True)
class FlowVoteConfig(Config):
    """Displacement histogram from which ICP of a group starts."""

    max_points: int = setting(
        "points of the other sweep that vote for one group at most, roughly", ge=1, le=10**6
    )
    cell_m: float = setting("edge of the cells of the displacement histogram", "m", ge=0.02, le=10)
    min_distance_m: float = setting(
        "mean distance of a group to the other sweep at rest, up to which it needs no vote: ICP gets there from rest",
        "m",
        ge=0,
        le=10,
    )
    max_rise_m: float = setting("pairs of points whose heights differ by more do not vote", "m", gt=0, le=10)
    peaks: int = setting("highest cells of the histogram that become start hypotheses", ge=1, le=100)
    starts: int = setting(
        "best start hypotheses that ICP follows for each group, besides standing still", ge=1, le=100
    )


@dataclass(frozen=True)
class FlowIcpConfig(Config):
    """Point-to-patch ICP about the vertical: a coarse pass over all starts, then a fine pass over the best."""

    coarse_points: int = setting(
        "points of each group that take part in the coarse pass at most", ge=5, le=10**6
    )
    fine_points: int = setting("points of each group that take part in the fine pass at most", ge=5, le=10**6)
    coarse_radii_m: tuple[float, ...] = setting(
        "correspondence radius of each step of the coarse pass, from wide to narrow", "m", gt=0, le=100
    )
    fine_radii_m: tuple[float, ...] = setting(
        "correspondence radius of each step of the fine pass, from wide to narrow", "m", gt=0, le=100
    )
    radius_spacings: float = setting(
        "a correspondence radius is at least this many spacings of the point, up to the first radius of its pass",
        ge=0,
        le=100,
    )
    stretch: tuple[float, ...] = setting(
        "factors by which the shift of the coarse pass is tried again: long sides hold it back", ge=0.1, le=10
    )
    slack: float = setting(
        "cost after the coarse pass, as a multiple of the highest one of use, above which there is no fine pass",
        ge=1,
        le=100,
    )
    min_pairs: int = setting("point pairs below which a group gets no motion", ge=3, le=10**6)
    tangential_weight: float = setting(
        "weight of a planar pair's residual along its plane; that of the residual across it is 1", gt=0, le=1
    )
    level_weight: float = setting(
        "weight, for each pair, of the prior that an object stays at its height", ge=0, le=1000
    )


@dataclass(frozen=True)
class FlowPlausibilityConfig(Config):
    """Which motions an object on the ground can have, and which a LiDAR can observe."""

    max_rise_m: float = setting("vertical displacement that any motion may have", "m", ge=0, le=10)
    max_rise_slope: float = setting(
        "further vertical displacement that a motion may have, as a share of its horizontal length",
        ge=0,
        le=10,
    )
    min_observable_share: float = setting(
        "share of a group's points whose surface must show the motion: a wall that slides along itself has none",
        ge=0,
        le=1,
    )
    misfit_per_m: float = setting(
        "misfit added for each metre of displacement: of two places that fit alike the nearer is likelier",
        "1/m",
        ge=0,
        le=100,
    )


@dataclass(frozen=True)
class FlowEvidenceConfig(Config):
    """What must speak for a motion, in both sweeps, beside the misfit that drops."""

    min_change_m: float = setting(
        "change of the distance to the other sweep from which a point speaks for a motion or against it",
        "m",
        gt=0,
        le=10,
    )
    min_change: float = setting("the same in point spacings; the larger of the two counts", ge=0, le=100)
    min_points: int = setting("points that must speak for a motion along the surface", ge=1, le=10**6)
    min_share: float = setting(
        "points that must speak for it, as a share of those that were sampled", ge=0, le=1
    )
    min_odds: float = setting("points that speak for it, for each that speaks against it", ge=0, le=1000)
    end_points: int = setting(
        "points of a component at which its ends are looked for, at most", ge=2, le=10**6
    )
    min_end_ratio: float = setting(
        "shift of one end of a long side as a share of the shift of its other end, at least", ge=0, le=1
    )
    mixed_share: float = setting(
        "share of a moved component that is explained at rest alone, above which a part of it stands",
        ge=0,
        le=1,
    )
    mixed_ratio: float = setting("the same, as a share of what its motion leaves unexplained", ge=0, le=1)
    slow_misfit: float = setting(
        "misfit at rest to the second sweep from which a component is tried with the third one", ge=0, le=100
    )
    third_misfit: float = setting("misfit at rest to the third sweep that such a component has", ge=0, le=100)
    slow_points: int = setting("points of such a component, at least", ge=1, le=10**6)
    contradiction: float = setting(
        "misfit to the confirming sweep, as a multiple of that at rest, from which it contradicts a motion",
        ge=0,
        le=100,
    )
    confirmation: float = setting(
        "the same for motions towards the confirming sweep: the target must fit them at least this well",
        ge=0,
        le=1,
    )
    vanished_misfit: float = setting(
        "misfit at rest from which a component has left the place in a sweep, or is hidden there",
        ge=0,
        le=1000,
    )


@dataclass(frozen=True)
class FlowResidualConfig(Config):
    """Second pass over patches that the motion of their component leaves unexplained."""

    patch_m: float = setting("edge of the cubic patches that are tested for a residual", "m", ge=0.05, le=20)
    patch_points: int = setting("points of each patch that are tested at most", ge=1, le=1000)
    min_points: int = setting(
        "source points that a component's unexplained patches, and then each part, must hold", ge=1, le=10**6
    )
    scale: float = setting(
        "`eps_m` and `voxel_m` are multiplied by this when a component is split into parts", gt=0, le=1
    )


@dataclass(frozen=True)
class RigidFlowConfig(Config):
    """One rigid motion for each connected component, by ICP."""

    max_speed_mps: float = setting("fastest motion that is searched for", "m/s", ge=0.1, le=80)
    eps_m: float = setting(
        "radius of the DBSCAN neighborhood that joins the points of both sweeps into components",
        "m",
        ge=0.05,
        le=20,
    )
    min_points: int = setting("points within `eps_m` that make a DBSCAN neighborhood dense", ge=1, le=10**6)
    voxel_m: float = setting("edge of the voxels whose centroids DBSCAN clusters", "m", ge=0.01, le=10)
    max_static_misfit: float = setting(
        "misfit at rest to the other sweep, in point spacings, up to which a component is static",
        ge=0,
        le=100,
    )
    min_gain: float = setting(
        "share by which a motion must lower the misfit of its component at rest", ge=0, le=1
    )
    screen_points: int = setting(
        "points of each component that decide whether it is static, at most", ge=1, le=10**6
    )
    occupancy_cell_m: float = setting(
        "edge of the cells in which only one moved component can be: the one that explains most keeps them",
        "m",
        ge=0.05,
        le=20,
    )
    spread_m: float = setting(
        "unexplained points up to this far from a moving thing share its motion where that explains them",
        "m",
        ge=0,
        le=20,
    )
    surface: FlowSurfaceConfig = table("surface estimates and misfit")
    vote: FlowVoteConfig = table("displacement histogram that gives the starts of ICP")
    icp: FlowIcpConfig = table("registration of a component with the other sweep")
    plausibility: FlowPlausibilityConfig = table("motions that are possible and observable")
    evidence: FlowEvidenceConfig = table("what must speak for a motion")
    residual: FlowResidualConfig = table("second pass over what the first leaves unexplained")
