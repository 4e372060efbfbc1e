"""Sweeps of a few objects whose points and motion are known, and the settings to propose boxes with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from upvl_cli.perception.proposals.cluster_fits import Sweep
from upvl_cli.perception.proposals.config import (
    BackgroundFilterConfig,
    ClusteringConfig,
    CrowdConfig,
    FrustumConfig,
    PersistenceConfig,
    ProposalBoxConfig,
    ProposalConfig,
)
from upvl_cli.perception.proposals.persistence import OccupancyHistory, occupied_places
from upvl_cli.perception.proposals.propose import Proposals, propose

CROWD = CrowdConfig(
    gap_m=0.2,
    voxel_m=0.05,
    min_points=3,
    min_width_m=0.2,
    max_width_m=1.2,
    min_height_m=0.8,
    max_height_m=2.2,
    min_share=0.9,
)
PERSISTENCE = PersistenceConfig(
    max_share=0.5, spans_s=(0.5, 1.0, 2.0), clearance_m=0.3, voxel_m=0.15, radius_m=0.25, time_tolerance=0.25
)
FRUSTUM = FrustumConfig(
    kinds=("person",),
    min_score=0.3,
    min_points=3,
    max_gap_m=0.7,
    max_depth_m=2.4,
    middle_share=0.7,
    min_filled=0.3,
    min_height_m=0.8,
    max_height_m=2.5,
    min_shared=0.6,
    max_claimed=0.5,
)
CONFIG = ProposalConfig(
    frustum=FRUSTUM,
    clustering=ClusteringConfig(
        eps_m=(1.0,),
        duplicate_iou=0.9,
        vertical_eps_m=1.0,
        scale_with_range=False,
        angular_eps_deg=1.2,
        use_velocity=True,
        velocity_eps_mps=1.5,
        use_vl=False,
        vl_eps=0.5,
        vl_dims=3,
        min_points=6,
        voxel_m=0.1,
    ),
    background=BackgroundFilterConfig(cluster=True, drop=True, max_share=0.99),
    persistence=PERSISTENCE,
    box=ProposalBoxConfig(
        moving_mps=1.0,
        ground_clearance_m=0.3,
        standing_height_m=1.5,
        trim=0.01,
        heading_step_deg=1.0,
        edge_floor_m=0.05,
        adoption_margin_m=0.1,
    ),
    crowd=CROWD,
)


def changed(**values: Any) -> ProposalConfig:
    """The settings with others in some places: `clustering__eps_m=0.6`."""
    config = CONFIG
    for name, value in values.items():
        table, key = name.split("__")
        config = replace(config, **{table: replace(getattr(config, table), **{key: value})})
    return config


def history(time_s: Any, sweeps: list[np.ndarray]) -> OccupancyHistory:
    """The occupied places of sweeps in world axes."""
    trees = [occupied_places(sweep, voxel_m=PERSISTENCE.voxel_m) for sweep in sweeps]
    return OccupancyHistory(np.asarray(time_s), trees)


NO_HISTORY = history(np.zeros(1), [np.zeros((0, 3))])


def car(x_m: float, y_m: float, heading_rad: float = 0.0) -> np.ndarray:
    """Points on the back and one side of a car 4 m long, 2 m wide, 1.5 m high, standing on z = 0."""
    across, along, up = np.arange(-1, 1.01, 0.1), np.arange(-2, 2.01, 0.1), np.arange(0.1, 1.51, 0.2)
    back = np.stack(np.meshgrid([-2.0], across, up), axis=-1).reshape(-1, 3)
    side = np.stack(np.meshgrid(along, [-1.0], up), axis=-1).reshape(-1, 3)
    points = np.concatenate([back, side])
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turned = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    return turned + [x_m, y_m, 0]


def block(x_m: float, y_m: float, size_lwh_m: tuple[float, float, float], step_m: float = 0.1) -> np.ndarray:
    """Points all through a block that stands on z = 0."""
    axes = [np.linspace(0, size, max(2, round(size / step_m) + 1)) for size in size_lwh_m]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid + [x_m - size_lwh_m[0] / 2, y_m - size_lwh_m[1] / 2, 0]


def spot(x_m: float, y_m: float, z_m: float = 1.0, points: int = 6) -> np.ndarray:
    """Points in one place, which is the center of its voxel if the coordinates end in 0.05."""
    return np.tile([x_m, y_m, z_m], (points, 1)).astype(float)


def sweep(*objects: tuple[np.ndarray, tuple[float, ...]]) -> Sweep:
    """Objects, each of points and a velocity; those that do not move are no candidates."""
    xyz = np.concatenate([points for points, _ in objects] or [np.zeros((0, 3))])
    speeds = [np.tile(np.resize([*velocity, 0.0], 3), (len(points), 1)) for points, velocity in objects]
    velocity = np.concatenate(speeds or [np.zeros((0, 3))])
    return Sweep(
        xyz_m=xyz,
        velocity_mps=velocity,
        is_candidate=np.linalg.norm(velocity, axis=1) >= 1.0,
        background=np.zeros(len(xyz), np.int8),
        vl_feature=np.zeros((len(xyz), 0)),
        height_m=xyz[:, 2],
        world_from_sweep=np.eye(4),
        step=0,
    )


def all_candidates(seen: Sweep) -> Sweep:
    """The sweep as it is for labels in all motion states."""
    return replace(seen, is_candidate=np.ones(len(seen.xyz_m), bool))


def proposals(seen: Sweep, occupied: OccupancyHistory = NO_HISTORY, **values: Any) -> Proposals:
    """The proposals of a sweep with one radius, with some settings changed."""
    (found,) = propose(seen, occupied, changed(**values))
    return found
