"""The network on streets with known boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import BOXES, SMALL, street

from upvl_cli.detector.batch import FEATURE, Grid, Sample, collate
from upvl_cli.detector.decode import Detections, detections
from upvl_cli.detector.loss import Losses, Space, losses
from upvl_cli.detector.model import HEADS, Detector, Output
from upvl_cli.detector.targets import targets
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.metrics.waymo.breakdown import ONE_SHARD
from upvl_cli.metrics.waymo.detection import detection
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import SCORE_CUTOFFS

SPACE = Space.of(np.full(100, 0.02, dtype=np.float32), np.eye(FEATURE, 100, dtype=np.float32))
ENCODERS = pytest.mark.parametrize("encoder", list(HEADS))


def fresh(encoder: str, *, distils: bool = True) -> Detector:
    torch.manual_seed(1)
    return Detector(SMALL, 8, encoder, distils)


def network(encoder: str = "anchors") -> Detector:
    """A fresh network that says something: no two places alike."""
    detector = fresh(encoder)
    with torch.no_grad():
        detector.says.weight.mul_(30)
    return detector


def boxes_of(detector: Detector, samples: list[Sample], min_score: float = 0.1) -> list[Detections]:
    with torch.inference_mode():
        output = detector(collate(samples, detector.grid))
    return detections(detector, output, min_score=min_score, max_boxes=20, nms_iou=0.2)


def said(detector: Detector, samples: list[Sample]) -> Output:
    with torch.inference_mode():
        return detector(collate(samples, detector.grid))


def wrong(detector: Detector, samples: list[Sample]) -> Losses:
    batch = collate(samples, detector.grid)
    return losses(detector, detector(batch), batch, targets(detector.head, batch.boxes), SPACE, distil=1.0)


def precision(found: Detections) -> float:
    """AP at 3D IoU 0.4 against the boxes of the street, of any class, by the official tool's rules."""
    n, m = len(BOXES), len(found.score)
    many = {"velocity_mps": np.zeros((n, 2)), "object_id": [str(i) for i in range(n)]}
    truth = Truth.from_rows(BOXES, sequence=["s"] * n, frame=[0] * n, type=[1] * n, level=[1] * n, **many)
    columns = {"sequence": ["s"] * m, "frame": [0] * m, "type": [1] * m, "score": found.score}
    columns |= {"velocity_mps": np.zeros((m, 2)), "object_id": ["p"] * m, "unlabelled": [False] * m}
    result = detection(
        truth,
        Predictions.from_rows(found.seven, **columns),
        iou_thresholds=[0.4] * 5,
        breakdowns=[ONE_SHARD],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    return result[0].ap


@ENCODERS
def test_one_frame_is_learnt_by_heart(encoder: str) -> None:
    sample, detector = street(1), fresh(encoder)
    batch = collate([sample], SMALL)
    known, rule = targets(detector.head, batch.boxes), torch.optim.AdamW(detector.parameters(), lr=5e-3)
    for _ in range(90):
        rule.zero_grad()
        loss = losses(detector, detector(batch), batch, known, SPACE, distil=1.0)
        loss.total.backward()
        rule.step()
    found = boxes_of(detector, [sample])[0]
    assert precision(found) == 1.0
    first = np.array([np.hypot(*(found.seven[:, :2] - box[:2]).T).argmin() for box in BOXES])
    turned = found.seven[first, 6] - BOXES[:, 6]
    assert np.cos(turned).min() > 0.9  # not half a turn either
    assert float(loss.distil.detach()) < 0.05


@ENCODERS
def test_a_batch_gives_what_its_samples_give_alone(encoder: str) -> None:
    detector, samples = network(encoder), [street(1), street(2, BOXES[:2]), street(3, BOXES[:0])]
    together = said(detector, samples)
    for number, sample in enumerate(samples):
        alone = said(detector, [sample])
        for part in ("objectness", "residual", "cells"):
            np.testing.assert_allclose(getattr(together, part)[number], getattr(alone, part)[0], atol=1e-4)
    whole = wrong(detector, samples)
    each = [wrong(detector, [sample]) for sample in samples]
    for part in ("total", "objectness", "box", "heading", "distil"):
        mean = torch.stack([getattr(one, part) for one in each]).mean()
        torch.testing.assert_close(getattr(whole, part), mean)


@ENCODERS
def test_the_order_of_points_does_not_matter(encoder: str) -> None:
    detector, sample = network(encoder), street(1)
    order = np.random.default_rng(0).permutation(len(sample.points))
    shuffled = replace(sample, points=sample.points[order])
    found, again = boxes_of(detector, [sample], 0.0)[0], boxes_of(detector, [shuffled], 0.0)[0]
    assert len(found.score) > 5
    np.testing.assert_allclose(found.seven, again.seven, atol=1e-3)
    np.testing.assert_allclose(found.score, again.score, atol=1e-5)


@ENCODERS
def test_the_same_step_gives_the_same_bytes(encoder: str) -> None:
    def step() -> bytes:
        detector = network(encoder)
        wrong(detector, [street(1), street(2)]).total.backward()
        return b"".join(weight.grad.numpy().tobytes() for weight in detector.parameters())

    assert step() == step()


def test_features_are_one_linear_layer_on_the_cell_and_the_point() -> None:
    detector, sample = network(), street(1)
    batch = collate([street(2), sample], SMALL)
    rows = torch.tensor([3, len(batch.points) - 1])
    with torch.inference_mode():
        cells = detector.backbone(detector.pillars(batch))
        told = detector.features(detector(batch), batch, rows)
    for row, one in zip(rows, told, strict=True):
        x, y, z, intensity, elongation, _ = batch.points[row]
        column, line = int((x + 12.8) // 0.8), int((y + 6.4) // 0.8)
        point = torch.stack([x / 12.8, y / 12.8, z / 2, intensity, elongation])
        value = torch.cat([cells[batch.of_sample[row], :, column, line], point])
        torch.testing.assert_close(one, detector.tells(value), atol=1e-5, rtol=1e-4)


def test_older_points_are_told_from_new_ones() -> None:
    detector, sample = network(), street(1)
    new = replace(sample, points=sample.points * np.array([1, 1, 1, 1, 1, 0], dtype=np.float32))
    assert not torch.equal(said(detector, [sample]).objectness, said(detector, [new]).objectness)


@ENCODERS
def test_a_frame_without_points_or_boxes(encoder: str) -> None:
    detector = network(encoder)
    empty = Sample.of_points(np.zeros((0, 6), dtype=np.float32))
    assert torch.isfinite(wrong(detector, [empty]).total)
    assert len(boxes_of(detector, [empty], 0.9)[0].seven) == 0


def test_distillation_adds_one_linear_layer() -> None:
    with_it, without = fresh("centres"), fresh("centres", distils=False)
    gone = set(with_it.state_dict()) - set(without.state_dict())
    assert gone == {"tells.weight", "tells.bias"}


def test_bf16_says_nearly_the_same() -> None:
    detector, batch = network(), collate([street(1)], SMALL)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        half = detector(batch).objectness
    whole = said(detector, [street(1)]).objectness
    assert half.dtype == torch.float32
    assert np.corrcoef(half.numpy().ravel(), whole.numpy().ravel())[0, 1] > 0.99


def test_only_points_and_boxes_in_the_grid_count() -> None:
    far = np.array([[12.9, 0, 0, 0, 0, 0], [0, 0, 9, 0, 0, 0], [np.nan, 0, 0, 0, 0, 0]], dtype=np.float32)
    sample = street(1)
    more = Sample(
        np.concatenate([far, sample.points]),
        np.concatenate([BOXES, BOXES[:1] + [20, 0, 0, 0, 0, 0, 0]]),
        np.concatenate([[0, 1], sample.seen + 3]),
        np.concatenate([np.ones((2, FEATURE), dtype=np.float32), sample.feature]),
    )
    batch, expected = collate([more], SMALL), collate([sample], SMALL)
    assert torch.equal(batch.points, expected.points)
    assert torch.equal(batch.seen, expected.seen)
    assert torch.equal(batch.feature, expected.feature)
    assert torch.equal(batch.boxes[0], expected.boxes[0])


def test_a_grid_has_whole_eights_of_pillars() -> None:
    assert Grid((-50, 50), (-20, 20), (-3, 5), 0.32).shape == (320, 128)
    assert SMALL.shape == (64, 32)


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: Detector(SMALL, 8, "circles", True), BadSetting, "expected one of: anchors, centres"),
        (lambda: Detector(SMALL, 12, "anchors", True), BadSetting, "multiple of 8"),
        (lambda: Grid((5, -5), (0, 1), (0, 1), 0.3), BadInput, "grid x_m goes from 5 to -5"),
        (lambda: Grid((0, 5), (0, 1), (0, 1), float("nan")), BadInput, "pillar_m is nan"),
        (
            lambda: Sample.of_points(np.zeros((4, 5))),
            BadInput,
            r"points has shape \(4, 5\), expected \(4, 6\)",
        ),
    ],
)
def test_wrong_settings_are_named(make, error, words) -> None:  # noqa: ANN001
    with pytest.raises(error, match=words):
        make()
