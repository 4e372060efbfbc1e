"""Many small coordinate networks evaluated at once, by grouped matrix products."""

from __future__ import annotations

import torch
from torch import Tensor

from upvl_cli.perception.flow.nsfp.config import FlowNetworkConfig

DIM = 3  # a position in, a flow out


def initial_parameters(config: FlowNetworkConfig, total: int, *, rest: bool) -> Tensor:
    """Return the (total, k) initial weights of networks, the same for each: those of torch's linear layers.

    What one network does thus depends neither on its place in the batch nor on the others. Weights and biases are
    uniform up to 1 / sqrt(inputs): with larger ones the first flow of a sweep is tens of metres, and no point has a
    neighbor before the cut of the Chamfer distance.

    Args:
        config: Layers, width and seed.
        total: Number of networks.
        rest: The weights of the last layer are 0, so that the first flow is 0.
    """
    generator = torch.Generator().manual_seed(config.seed)
    layers = _layers(config)
    parts = []
    for number, (inputs, outputs) in enumerate(layers):
        bound = 0.0 if rest and number + 1 == len(layers) else inputs**-0.5
        parts.append((2 * torch.rand((inputs + 1) * outputs, generator=generator) - 1) * bound)
    return torch.cat(parts).repeat(total, 1)


def apply_networks(config: FlowNetworkConfig, parameters: Tensor, xyz_m: Tensor) -> Tensor:
    """Return the (c, p, 3) output of c networks, each at p positions of its own.

    Args:
        config: Layers and width.
        parameters: (c, k) weights, as `initial_parameters` arranges them.
        xyz_m: (c, p, 3) positions.
    """
    layers = _layers(config)
    sizes = [size for inputs, outputs in layers for size in (inputs * outputs, outputs)]
    parts = torch.split(parameters, sizes, dim=1)
    values = xyz_m
    for number, (inputs, outputs) in enumerate(layers):
        weight = parts[2 * number].reshape(-1, inputs, outputs)
        bias = parts[2 * number + 1].reshape(-1, 1, outputs)
        values = torch.baddbmm(bias, values, weight)
        if number + 1 < len(layers):
            values = values.relu()
    return values


def _layers(config: FlowNetworkConfig) -> list[tuple[int, int]]:
    """Return the number of inputs and outputs of each layer."""
    sizes = [DIM, *[config.width] * config.hidden_layers, DIM]
    return list(zip(sizes, sizes[1:], strict=False))
