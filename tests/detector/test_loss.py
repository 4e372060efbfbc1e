"""Losses against numbers by hand, and their gradients against small differences."""

from __future__ import annotations

from dataclasses import replace
from math import exp, log, pi

import numpy as np
import pytest
import torch
from scenes import CODERS, SHIPPED, small_config, small_head, street
from torch.autograd import gradcheck

from upvl_cli.detector.data.batch import collate
from upvl_cli.detector.loss import (
    Criterion,
    FeatureSpace,
    box_losses,
    distillation_loss,
    losses,
    objectness_loss,
)
from upvl_cli.detector.model import Detector
from upvl_cli.detector.targets import Targets, make_targets

HEADS = pytest.mark.parametrize("box_coder", CODERS)
LOSS = SHIPPED.loss


def doubles(*shape: int, seed: int = 0) -> torch.Tensor:
    torch.manual_seed(seed)
    return torch.randn(*shape, dtype=torch.float64, requires_grad=True)


def known(size: int = 2, anchors: int = 5) -> Targets:
    """Two boxes in the first sample, one in the second, none in others; the last anchor is ignored."""
    torch.manual_seed(3)
    residual = torch.randn(3, 8, dtype=torch.float64)
    residual[:, 7] = torch.tensor([1.0, 0.0, 1.0])
    weight = torch.ones(size, anchors, dtype=torch.float64)
    weight[:, -1] = 0
    return Targets(weight, torch.tensor([0, 0, 1]), torch.tensor([1, 3, 0]), residual)


def space(d: int = 90) -> tuple[FeatureSpace, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    mean, components = rng.normal(size=d) / 10, np.linalg.qr(rng.normal(size=(d, d)))[0][:64]
    exact = FeatureSpace.from_basis(mean, components)
    return FeatureSpace(exact.square.double(), exact.cross.double(), exact.gram.double()), mean, components


def test_gradient_of_objectness() -> None:
    assert gradcheck(lambda prediction: objectness_loss(prediction, known(), LOSS), doubles(2, 5))


@HEADS
@pytest.mark.parametrize("part", [0, 1])
def test_gradient_of_boxes_and_headings(box_coder: str, part: int) -> None:
    head = small_head(box_coder)
    assert gradcheck(lambda prediction: box_losses(head, prediction, known(), LOSS)[part], doubles(2, 5, 8))


def test_gradient_of_features() -> None:
    true, of_sample = doubles(4, 64, seed=1).detach(), torch.tensor([0, 0, 0, 2])
    assert gradcheck(
        lambda prediction: distillation_loss(prediction, true, of_sample, 3, space()[0]), doubles(4, 64)
    )


def test_objectness_by_hand() -> None:
    # Logits of 0 are a probability of 1/2: alpha 1/4 or 3/4, times (1/2)^2, times log 2. Sample 0 has 2 boxes in 4
    # anchors that are not ignored, sample 1 has one in 4, sample 2 none in 4.
    half = 0.25 * log(2)
    each = [(2 * 0.25 + 2 * 0.75) * half / 2, (0.25 + 3 * 0.75) * half, 4 * 0.75 * half]
    prediction = torch.zeros(3, 5, dtype=torch.float64)
    prediction[:, -1] = 9.0  # wrong, and ignored
    assert objectness_loss(prediction, known(3), LOSS).item() == pytest.approx(sum(each) / 3)


def test_boxes_by_hand() -> None:
    truth = known(3)
    prediction = torch.zeros(3, 5, 8, dtype=torch.float64)
    prediction[truth.sample, truth.anchor] = truth.residual
    prediction[0, 1, 2] += 2.0  # beyond delta = 1/9 the loss is the difference less half of delta
    box, heading = box_losses(small_head("centers"), prediction, truth, LOSS)
    assert box.item() == pytest.approx((2 - 1 / 18) / 2 / 3)  # one of two boxes, one of three samples
    assert heading.item() == 0


@pytest.mark.parametrize(
    ("turned", "direction", "expected", "why"),
    [
        (0.0, 30.0, 0.0, "right"),
        (pi, 30.0, 0.0, "half a turn is the same box"),
        (pi / 2, 30.0, 0.5, "a quarter of a turn is the worst"),
        (0.0, 0.0, 0.2 * log(2), "not sure which end is in front"),
    ],
)
def test_headings_of_anchors_by_hand(turned: float, direction: float, expected: float, why: str) -> None:
    prediction, code = torch.tensor([[0.3 + turned, direction]]), torch.tensor([[0.3, 1.0]])
    loss = small_head("anchors").heading_loss(prediction, code).item()
    assert loss == pytest.approx(expected, abs=1e-6), why


def test_cosines_are_those_of_the_full_space() -> None:
    short, mean, components = space()
    a, b = doubles(5, 64).detach(), doubles(5, 64, seed=1).detach()
    full_a, full_b = mean + a.numpy() @ components, mean + b.numpy() @ components
    lengths = np.linalg.norm(full_a, axis=1) * np.linalg.norm(full_b, axis=1)
    np.testing.assert_allclose(short.cosine(a, b), (full_a * full_b).sum(axis=1) / lengths, atol=1e-6)


def test_features_of_a_sample_without_any_cost_nothing() -> None:
    short = space()[0]
    prediction, true = doubles(2, 64).detach(), doubles(2, 64, seed=1).detach()
    loss = distillation_loss(prediction, true, torch.tensor([1, 1]), 3, short)
    assert loss.item() == pytest.approx((1 - short.cosine(prediction, true)).mean().item() / 3)


def test_objectness_is_the_focal_loss_of_a_plain_loop() -> None:
    config, truth, logits = replace(LOSS, focal_alpha=0.3, focal_gamma=1.5), known(), doubles(2, 5).detach()
    positives = {(0, 1), (0, 3), (1, 0)}
    of_sample = []
    for sample in range(2):
        total = 0.0
        for anchor in range(4):  # the last one is ignored
            p = 1 / (1 + exp(-logits[sample, anchor].item()))
            right, alpha = (p, 0.3) if (sample, anchor) in positives else (1 - p, 0.7)
            total += alpha * (1 - right) ** 1.5 * -log(right)
        of_sample.append(total / sum(where[0] == sample for where in positives))
    assert objectness_loss(logits, truth, config).item() == pytest.approx(sum(of_sample) / 2)


def test_boxes_have_the_huber_loss_of_a_plain_loop() -> None:
    config, truth, prediction = replace(LOSS, huber_delta=0.7), known(), doubles(2, 5, 8).detach()
    of_sample = {0: [0.0, 0.0], 1: [0.0]}
    for row, (sample, anchor) in enumerate(zip([0, 0, 1], [1, 3, 0], strict=True)):
        for dim in range(6):
            error = abs((prediction[sample, anchor, dim] - truth.residual[row, dim]).item())
            of_sample[sample][row % 2] += error**2 / 1.4 if error < 0.7 else error - 0.35
    expected = (sum(of_sample[0]) / 2 + of_sample[1][0]) / 2
    assert box_losses(small_head("centers"), prediction, truth, config)[0].item() == pytest.approx(expected)


def test_headings_of_centers_by_hand() -> None:
    prediction, code = torch.tensor([[0.5, 3.0]]), torch.tensor([[0.0, 1.0]])
    loss = small_head("centers").heading_loss(prediction, code).item()
    assert loss == pytest.approx(0.125 + 1.5)  # a square's half up to 1, then a line


def test_the_total_has_each_part_with_its_weight() -> None:
    torch.manual_seed(1)
    detector = Detector(small_config(), True)
    batch = collate([street(1), street(2)], detector.grid)
    output, truth = detector(batch), make_targets(detector.head, batch.boxes)
    exact = FeatureSpace.from_basis(np.full(70, 0.1, np.float32), np.eye(64, 70, dtype=np.float32))
    once = Criterion(exact, replace(LOSS, box_weight=1.0), replace(SHIPPED.distillation, weight=1.0))
    more = Criterion(exact, replace(LOSS, box_weight=3.0), replace(SHIPPED.distillation, weight=5.0))
    one, other = (losses(detector, output, batch, truth, criterion) for criterion in (once, more))
    torch.testing.assert_close(other.objectness, one.objectness)
    torch.testing.assert_close(other.box, 3 * one.box)
    torch.testing.assert_close(other.heading, 3 * one.heading)
    torch.testing.assert_close(other.distillation, 5 * one.distillation)
    for part in (one, other):
        torch.testing.assert_close(part.total, part.objectness + part.box + part.heading + part.distillation)
    # Of the points that a camera sees, those of each sample alone.
    prediction = detector.features(output, batch, batch.seen)
    distance = 1 - exact.cosine(prediction, batch.feature)
    is_first = batch.of_sample[batch.seen] == 0
    mean = (distance[is_first].mean() + distance[~is_first].mean()) / 2
    torch.testing.assert_close(one.distillation, mean)


def test_a_network_without_the_head_has_no_loss_of_features() -> None:
    torch.manual_seed(1)
    detector = Detector(small_config(), False)
    batch = collate([street(1)], detector.grid)
    criterion = Criterion(space()[0], LOSS, SHIPPED.distillation)
    part = losses(detector, detector(batch), batch, make_targets(detector.head, batch.boxes), criterion)
    assert part.distillation.item() == 0
    torch.testing.assert_close(part.total, part.objectness + part.box + part.heading)
