"""NSFP++: local flow by a network for each connected component, all optimised as one batch.

Najibi et al., Motion Inspired Unsupervised Perception and Prediction in Autonomous Driving, ECCV 2022, section 4.1.
Ground and ego motion are out already.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.flow.nsfp.chamfer import PointSets
from upvl_cli.perception.flow.nsfp.components import FlowComponent, connected_components
from upvl_cli.perception.flow.nsfp.config import NsfpPlusPlusConfig
from upvl_cli.perception.flow.nsfp.nsfp import evaluate_network, spread_sample
from upvl_cli.perception.flow.nsfp.optimization import FlowObjective, fit_networks
from upvl_cli.perception.flow.nsfp.torch_device import fixed_order_of_sums
from upvl_cli.perception.flow.surface import build_tree
from upvl_cli.types import Floats


def estimate_nsfp_plus_plus_flow(
    source_xyz_m: Floats, target_xyz_m: Floats, dt_s: float, config: NsfpPlusPlusConfig
) -> Floats:
    """Estimate the (n, 3) velocity over the ground of each source point in m/s; 0 for static points and noise.

    Args:
        source_xyz_m: (n, 3) points above the ground.
        target_xyz_m: (m, 3) the same of the other sweep, in the axes of the source.
        dt_s: Time from source to target; negative when the target came before.
        config: The method's settings.
    """
    flow_m = np.zeros((len(source_xyz_m), 3))
    if not len(source_xyz_m) or not len(target_xyz_m):
        return flow_m
    components = connected_components(source_xyz_m, target_xyz_m, dt_s, config)
    # Those of similar size share a batch, which is as long as its largest.
    components.sort(key=lambda component: -len(component.point))
    with fixed_order_of_sums(config.device):
        for first in range(0, len(components), config.max_batch):
            batch = components[first : first + config.max_batch]
            for component, moved_m in zip(batch, fit_components(source_xyz_m, batch, config), strict=True):
                if _is_gain(source_xyz_m[component.point], component, moved_m, config.min_gain):
                    flow_m[component.point] = moved_m
    return flow_m / dt_s


def fit_components(
    source_m: Floats, components: list[FlowComponent], config: NsfpPlusPlusConfig
) -> list[Floats]:
    """Fit the networks of components as one batch, and return the (n, 3) displacement of the points of each.

    A network sees positions from the mean of its component, and gives the displacement beyond the start.

    Args:
        source_m: (n, 3) points of the sweep.
        components: Which of them belong together, and what they may correspond to.
        config: The method's settings.
    """
    local_m, near_m = [], []
    for component in components:
        points_m = source_m[component.point]
        center_m = points_m.mean(axis=0)
        local_m.append(points_m - center_m)
        near_m.append(component.target_m - center_m - component.start_m)
    source, target = (
        PointSets.of([spread_sample(points, max_points) for points in sets], config.device)
        for sets, max_points in ((local_m, config.max_points), (near_m, config.max_target_points))
    )
    objective = FlowObjective(config.network, config.optimizer, config.consistency, rest=True)
    parameters = fit_networks(source, target, objective).parameters
    return [
        component.start_m + evaluate_network(objective, parameters[number : number + 1], points_m)
        for number, (component, points_m) in enumerate(zip(components, local_m, strict=True))
    ]


def _is_gain(points_m: Floats, component: FlowComponent, moved_m: Floats, min_gain: float) -> bool:
    """Whether a displacement brings a component nearer to the other sweep, by that share of its distance at rest."""
    if not min_gain:
        return True
    tree = build_tree(component.near_m)
    at_rest_m, after_m = (tree.query(points)[0].mean() for points in (points_m, points_m + moved_m))
    return bool(after_m <= (1 - min_gain) * at_rest_m)
