"""Optimisation of many flow networks as one batch, each with an early stop of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from upvl_cli.perception.flow.nsfp.chamfer import PointSets, chamfer
from upvl_cli.perception.flow.nsfp.config import (
    FlowConsistencyConfig,
    FlowNetworkConfig,
    FlowOptimizerConfig,
)
from upvl_cli.perception.flow.nsfp.network import apply_networks, initial_parameters

# Kingma and Ba, Adam: A Method for Stochastic Optimization, ICLR 2015, the values of the paper.
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
SMOOTH_M = 1e-3  # rounds off the tip of a distance, whose gradient at 0 is not defined
DONE_SHARE = 0.25  # share of networks that are done at which the batch is made smaller


@dataclass(frozen=True)
class FlowObjective:
    """What is minimised.

    Attributes:
        network: The networks.
        optimizer: Cut of the Chamfer distance, backward network, and how Adam runs.
        consistency: The term of local consistency; None for none.
        rest: The optimisation starts at a flow of 0, not at a random one.
    """

    network: FlowNetworkConfig
    optimizer: FlowOptimizerConfig
    consistency: FlowConsistencyConfig | None
    rest: bool

    def loss(self, parameters: list[Tensor], source: PointSets, target: PointSets) -> Tensor:
        """Return the (c,) loss of each network.

        Args:
            parameters: (c, k) weights of the forward networks, and those of the backward networks where there are any.
            source: Points of c components.
            target: Points of the other sweep that each may correspond to.
        """
        max_distance_m = self.optimizer.max_distance_m
        flow_m = apply_networks(self.network, parameters[0], source.xyz_m)
        moved = PointSets(source.xyz_m + flow_m, source.size)
        loss = chamfer(moved, target, max_distance_m)
        if self.optimizer.backward:
            back_m = apply_networks(self.network, parameters[1], moved.xyz_m)
            returned = PointSets(moved.xyz_m - back_m, source.size)
            loss = loss + chamfer(returned, source, max_distance_m)
        if self.consistency is not None and self.consistency.weight:
            loss = loss + self.consistency.weight * inconsistency(flow_m, source, self.consistency)
        return loss


def inconsistency(flow_m: Tensor, points: PointSets, config: FlowConsistencyConfig) -> Tensor:
    """Return the (c,) mean distance between the flow of points of each set and that of a sample of them.

    Args:
        flow_m: (c, p, 3) flow of each point.
        points: c sets of up to p points.
        config: The sample, which is spread evenly over the set, and which pairs count.
    """
    step = torch.arange(config.points, device=points.size.device)
    sample = (step * points.size[:, None] // config.points)[..., None].expand(-1, -1, 3)  # (c, k, 3)
    apart_m = (points.xyz_m[:, :, None] - points.xyz_m.gather(1, sample)[:, None]).square().sum(-1).sqrt()
    counts = (apart_m <= config.radius_m) & points.is_point[..., None]  # (c, p, k)
    squared_m2 = (flow_m[:, :, None] - flow_m.gather(1, sample)[:, None]).square().sum(-1)
    distance_m = (squared_m2 + SMOOTH_M**2).sqrt() - SMOOTH_M
    return (distance_m * counts).sum((1, 2)) / counts.sum((1, 2))


class FittedNetworks(NamedTuple):
    """The best state of each network.

    Attributes:
        parameters: (c, k) weights of the forward networks at their lowest loss.
        loss: (c,) that loss.
        iterations: (c,) iterations until the network was done.
    """

    parameters: Tensor
    loss: Tensor
    iterations: Tensor


def fit_networks(source: PointSets, target: PointSets, objective: FlowObjective) -> FittedNetworks:
    """Fit one forward (and one backward) network to each pair of point sets, all at once.

    Each network stops when its own loss has not improved for `patience` iterations; those that are done leave the
    batch now and then. The result of one does not depend on the others, but for the rounding of sums.

    Args:
        source: Points of c components.
        target: Points of the other sweep that each may correspond to, none of them empty.
        objective: What is minimised, and how.
    """
    optimizer, device = objective.optimizer, source.size.device
    total = len(source.size)
    first = initial_parameters(objective.network, total, rest=objective.rest).to(device)
    parameters = [first.clone() for _ in range(1 + optimizer.backward)]
    moments = [(torch.zeros_like(first), torch.zeros_like(first)) for _ in parameters]
    best = FittedNetworks(
        first.clone(), torch.full((total,), torch.inf, device=device), torch.zeros(total, device=device)
    )
    counted = best.loss.clone()  # loss from which the patience of each counts
    waited = torch.zeros(total, device=device)
    index = torch.arange(total, device=device)  # which networks the batch holds
    for iteration in range(optimizer.max_iterations):
        gradients, loss = _gradients(objective, parameters, source, target)
        with torch.no_grad():
            running = waited[index] < optimizer.patience
            if not bool(running.any()):
                break
            better = running & (loss < best.loss[index])
            best.parameters[index[better]] = parameters[0][better]
            best.loss[index[better]] = loss[better]
            best.iterations[index[running]] = iteration + 1
            improved = loss < counted[index] - optimizer.min_improvement
            counted[index[improved]] = loss[improved]
            waited[index] = torch.where(improved & running, 0, waited[index] + 1)
            for values, gradient, moment in zip(parameters, gradients, moments, strict=True):
                _adam_step(values, gradient, moment, iteration + 1, optimizer)
            running = waited[index] < optimizer.patience
            if 0 < int(running.sum()) <= (1 - DONE_SHARE) * len(index):
                kept = running.nonzero()[:, 0]
                index, source, target = index[kept], source[kept], target[kept]
                parameters = [values[kept] for values in parameters]
                moments = [(mean[kept], square[kept]) for mean, square in moments]
    return best


def _gradients(
    objective: FlowObjective, parameters: list[Tensor], source: PointSets, target: PointSets
) -> tuple[tuple[Tensor, ...], Tensor]:
    """Return the gradient of each tensor of parameters, and the (c,) losses."""
    leaves = [values.requires_grad_() for values in parameters]
    loss = objective.loss(leaves, source, target)
    gradients = torch.autograd.grad(loss.sum(), leaves)
    for values in parameters:
        values.requires_grad_(False)
    return gradients, loss.detach()


def _adam_step(
    values: Tensor, gradient: Tensor, moment: tuple[Tensor, Tensor], step: int, optimizer: FlowOptimizerConfig
) -> None:
    """Update parameters in place by one step of Adam."""
    mean, square = moment
    if optimizer.weight_decay:
        gradient = gradient + optimizer.weight_decay * values
    mean.lerp_(gradient, 1 - BETA_1)
    square.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
    root = square.sqrt().mul_((1 - BETA_2**step) ** -0.5).add_(EPSILON)
    values.addcdiv_(mean, root, value=-optimizer.learning_rate / (1 - BETA_1**step))
