"""Batches of flow networks against one network after the other, and against torch's own layers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.nsfp import chamfer as chamfer_module
from upvl_cli.perception.flow.nsfp.chamfer import PointSets, chamfer, nearest
from upvl_cli.perception.flow.nsfp.config import (
    FlowConsistencyConfig,
    FlowNetworkConfig,
    FlowOptimizerConfig,
)
from upvl_cli.perception.flow.nsfp.network import apply_networks, initial_parameters
from upvl_cli.perception.flow.nsfp.optimization import FlowObjective, fit_networks, inconsistency

NETWORK = FlowNetworkConfig(hidden_layers=2, width=8, seed=3)
OPTIMIZER = FlowOptimizerConfig(
    learning_rate=0.01,
    weight_decay=0.0,
    max_iterations=60,
    patience=6,
    min_improvement=1e-3,
    max_distance_m=1.0,
    backward=True,
)
CONSISTENCY = FlowConsistencyConfig(weight=0.1, radius_m=2.0, points=4)
SIZES = (5, 12, 3, 30)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def clouds(seed: int, sizes: tuple[int, ...] = SIZES) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(0, 1, (size, 3)) for size in sizes]


def test_a_batch_of_networks_is_torchs_own_layers() -> None:
    parameters = torch.cat(
        [initial_parameters(FlowNetworkConfig(2, 8, seed), 1, rest=False) for seed in (1, 2)]
    )
    parameters[:, 24:32] = 0.5  # biases of the first layer
    xyz = torch.randn(2, 7, 3, generator=torch.Generator().manual_seed(0))
    found = apply_networks(NETWORK, parameters, xyz)
    for row, points, values in zip(parameters, xyz, found, strict=True):
        first, second, last = torch.nn.Linear(3, 8), torch.nn.Linear(8, 8), torch.nn.Linear(8, 3)
        begin = 0
        for layer in (first, second, last):
            inputs, outputs = layer.in_features, layer.out_features
            middle, end = begin + inputs * outputs, begin + inputs * outputs + outputs
            layer.weight.data = row[begin:middle].reshape(inputs, outputs).T
            layer.bias.data = row[middle:end]
            begin = end
        assert begin == parameters.shape[1]
        plain = torch.nn.Sequential(first, torch.nn.ReLU(), second, torch.nn.ReLU(), last)
        torch.testing.assert_close(values, plain(points))


def test_initial_weights_are_equal_and_start_at_rest_where_asked() -> None:
    parameters = initial_parameters(NETWORK, 2, rest=True)
    assert torch.equal(parameters[0], parameters[1])
    assert apply_networks(NETWORK, parameters, torch.ones(2, 4, 3)).abs().max() == 0
    assert (
        apply_networks(NETWORK, initial_parameters(NETWORK, 1, rest=False), torch.ones(1, 4, 3)).abs().max()
        > 0
    )


@pytest.mark.parametrize("tree_pairs", [0, 10**9], ids=["trees", "all distances"])
@pytest.mark.parametrize("block_pairs", [1, 10**9], ids=["in blocks", "at once"])
def test_chamfer_is_that_of_each_pair_alone(
    tree_pairs: int, block_pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chamfer_module, "TREE_PAIRS", tree_pairs)
    monkeypatch.setattr(chamfer_module, "BLOCK_PAIRS", block_pairs)
    left, right = clouds(0), [points + (5, 0, 0) for points in clouds(1, (4, 9, 30, 1))]
    right[1] -= (5, 0, 0)
    found = chamfer(PointSets.of(left, "cpu"), PointSets.of(right, "cpu"), 2.0)
    for one, other, value in zip(left, right, found, strict=True):
        there, back = cKDTree(other).query(one)[0], cKDTree(one).query(other)[0]
        plain = np.minimum(there**2, 4).mean() + np.minimum(back**2, 4).mean()
        assert float(value) == pytest.approx(plain, rel=1e-5)


def test_no_gradient_beyond_the_cut() -> None:
    moved = torch.tensor([[[0.0, 0, 0], [50, 0, 0]]], requires_grad=True)
    target = PointSets.of([np.array([[0.5, 0, 0]])], "cpu")
    chamfer(PointSets(moved, torch.tensor([2])), target, 1.0).sum().backward()
    assert moved.grad is not None
    assert moved.grad[0, 0, 0] < 0
    assert moved.grad[0, 1].abs().max() == 0


def test_nearest_places_are_points() -> None:
    """The zeros that fill a set up are no point, though they are nearest."""
    queries = PointSets.of([np.zeros((1, 3)), np.zeros((2, 3))], "cpu")
    others = PointSets.of([np.full((1, 3), 9.0), np.full((3, 3), 9.0)], "cpu")
    assert nearest(queries, others)[0, 0] == 0


def test_inconsistency_is_the_mean_over_near_pairs() -> None:
    points, flow = clouds(2), clouds(3)
    config = FlowConsistencyConfig(weight=1.0, radius_m=1.5, points=4)
    found = inconsistency(PointSets.of(flow, "cpu").xyz_m, PointSets.of(points, "cpu"), config)
    for xyz, shift, value in zip(points, flow, found, strict=True):
        sample = np.arange(4) * len(xyz) // 4
        near = np.linalg.norm(xyz[:, None] - xyz[sample], axis=2) <= 1.5
        apart = np.linalg.norm(shift[:, None] - shift[sample], axis=2)
        assert float(value) == pytest.approx(apart[near].mean(), abs=2e-3)


def objective(**changes: object) -> FlowObjective:
    values = {name: getattr(OPTIMIZER, name) for name in OPTIMIZER.__dataclass_fields__} | changes
    return FlowObjective(NETWORK, FlowOptimizerConfig(**values), CONSISTENCY, rest=True)  # type: ignore[arg-type]


@pytest.mark.parametrize("backward", [True, False])
def test_a_batch_gives_what_each_component_gets_alone(backward: bool) -> None:
    """Stops differ, so that the batch shrinks on the way."""
    sources = clouds(4)
    targets = [points[:: 1 + number % 2] + (0.1 * number, -0.05, 0) for number, points in enumerate(sources)]
    aim = objective(backward=backward)
    together = fit_networks(PointSets.of(sources, "cpu"), PointSets.of(targets, "cpu"), aim)
    alone = [
        fit_networks(PointSets.of([source], "cpu"), PointSets.of([target], "cpu"), aim)
        for source, target in zip(sources, targets, strict=True)
    ]
    assert len({int(one.iterations[0]) for one in alone}) > 2
    assert together.iterations.tolist() == [float(one.iterations[0]) for one in alone]
    for number, one in enumerate(alone):
        torch.testing.assert_close(together.parameters[number], one.parameters[0], rtol=1e-3, atol=1e-4)
        torch.testing.assert_close(together.loss[number], one.loss[0], rtol=1e-4, atol=1e-6)


def test_adam_is_torchs() -> None:
    source, target = PointSets.of(clouds(5, (9,)), "cpu"), PointSets.of(clouds(6, (8,)), "cpu")
    aim = objective(max_iterations=5, patience=100, weight_decay=0.01)
    found = fit_networks(source, target, aim)
    weights = [initial_parameters(NETWORK, 1, rest=True).requires_grad_() for _ in range(2)]
    plain = torch.optim.Adam(weights, lr=aim.optimizer.learning_rate, weight_decay=0.01)
    losses = []
    for _ in range(5):
        plain.zero_grad()
        loss = aim.loss([*weights], source, target).sum()
        loss.backward()
        losses.append(float(loss.detach()))
        plain.step()
    assert float(found.loss[0]) == pytest.approx(min(losses), rel=1e-5)


def test_the_best_is_kept_and_not_the_last() -> None:
    """A learning rate that overshoots."""
    source, target = PointSets.of(clouds(7), "cpu"), PointSets.of(clouds(8), "cpu")
    aim = objective(learning_rate=0.5, max_iterations=20)
    found = fit_networks(source, target, aim)
    forward_alone = objective(backward=False)
    kept = forward_alone.loss([found.parameters], source, target)
    at_rest = forward_alone.loss([initial_parameters(NETWORK, len(SIZES), rest=True)], source, target)
    assert bool((kept <= at_rest + 1e-6).all())


def test_a_network_stops_when_its_loss_no_longer_falls() -> None:
    same = clouds(9, (20,))
    found = fit_networks(
        PointSets.of(same, "cpu"), PointSets.of(same, "cpu"), objective(max_iterations=500, patience=5)
    )
    assert float(found.iterations[0]) == 6  # the first counts as an improvement
    assert float(found.loss[0]) == pytest.approx(0, abs=1e-6)
