"""NSFP: the flow of a sweep is a network that is optimised for this pair of sweeps alone.

Li, Pontes and Lucey, Neural Scene Flow Prior, NeurIPS 2021.
"""

from __future__ import annotations

import numpy as np
import torch

from upvl_cli.perception.flow.nsfp.chamfer import PointSets
from upvl_cli.perception.flow.nsfp.config import NsfpFlowConfig
from upvl_cli.perception.flow.nsfp.network import apply_networks
from upvl_cli.perception.flow.nsfp.optimization import FlowObjective, fit_networks
from upvl_cli.perception.flow.nsfp.torch_device import fixed_order_of_sums
from upvl_cli.types import Floats

BLOCK_POINTS = 2**14  # points at which a network is evaluated at once


def estimate_nsfp_flow(
    source_xyz_m: Floats, target_xyz_m: Floats, dt_s: float, config: NsfpFlowConfig
) -> Floats:
    """Estimate the (n, 3) velocity over the ground of each source point in m/s by one network for all.

    Args:
        source_xyz_m: (n, 3) points above the ground.
        target_xyz_m: (m, 3) the same of the other sweep, in the axes of the source.
        dt_s: Time from source to target; negative when the target came before.
        config: The method's settings.
    """
    if not len(source_xyz_m) or not len(target_xyz_m):
        return np.zeros((len(source_xyz_m), 3))
    source, target = (
        PointSets.of([spread_sample(points, config.max_points)], config.device)
        for points in (source_xyz_m, target_xyz_m)
    )
    objective = FlowObjective(config.network, config.optimizer, consistency=None, rest=False)
    with fixed_order_of_sums(config.device):
        parameters = fit_networks(source, target, objective).parameters
        return evaluate_network(objective, parameters, source_xyz_m) / dt_s


def spread_sample(points: Floats, max_points: int) -> Floats:
    """Return at most that many rows of an array, spread evenly over their order."""
    if len(points) <= max_points:
        return points
    return points[np.arange(max_points) * len(points) // max_points]


@torch.no_grad()
def evaluate_network(objective: FlowObjective, parameters: torch.Tensor, xyz_m: Floats) -> Floats:
    """Return the (n, 3) output of one network at any points, float64.

    Args:
        objective: Names the layers of the network.
        parameters: (1, k) weights.
        xyz_m: (n, 3) positions.
    """
    values = torch.from_numpy(np.asarray(xyz_m, np.float32)).to(parameters.device)
    parts = [
        apply_networks(objective.network, parameters, part[None])[0]
        for part in torch.split(values, BLOCK_POINTS)
    ]
    return torch.cat(parts).double().cpu().numpy()
