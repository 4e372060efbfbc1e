"""The network on streets with known boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import BOXES, CODERS, DECODING, SHIPPED, SMALL, shifted, small_config, street

from upvl_cli.detector.data.batch import FEATURE_DIM, Sample, collate
from upvl_cli.detector.decode import Detections, decode_output
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.heads.anchors import Anchors
from upvl_cli.detector.loss import Criterion, FeatureSpace, Losses, losses
from upvl_cli.detector.model import Detector, Output
from upvl_cli.detector.targets import make_targets
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.metrics.waymo.breakdown import ONE_SHARD
from upvl_cli.metrics.waymo.detection import detection
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import SCORE_CUTOFFS
from upvl_cli.types import Boxes, concat

SPACE = FeatureSpace.from_basis(
    np.full(100, 0.02, dtype=np.float32), np.eye(FEATURE_DIM, 100, dtype=np.float32)
)
CRITERION = Criterion(SPACE, SHIPPED.loss, SHIPPED.distillation)
GRID = Grid.of(SMALL)
BOX_CODERS = pytest.mark.parametrize("box_coder", CODERS)


def fresh(box_coder: str, *, distills: bool = True) -> Detector:
    torch.manual_seed(1)
    return Detector(small_config(box_coder), distills)


def network(box_coder: str = "anchors") -> Detector:
    """A fresh network whose output differs from anchor to anchor."""
    detector = fresh(box_coder)
    with torch.no_grad():
        detector.box_head.weight.mul_(30)
    return detector


def boxes_of(detector: Detector, samples: list[Sample], min_score: float = 0.1) -> list[Detections]:
    with torch.inference_mode():
        output = detector(collate(samples, detector.grid))
    return decode_output(detector, output, replace(DECODING, min_score=min_score, max_boxes=20, nms_iou=0.2))


def output_of(detector: Detector, samples: list[Sample]) -> Output:
    with torch.inference_mode():
        return detector(collate(samples, detector.grid))


def losses_of(detector: Detector, samples: list[Sample]) -> Losses:
    batch = collate(samples, detector.grid)
    return losses(detector, detector(batch), batch, make_targets(detector.head, batch.boxes), CRITERION)


def precision(found: Detections) -> float:
    """AP at 3D IoU 0.4 against the boxes of the street, of any class, by the official tool's rules."""
    n, m = len(BOXES), len(found.score)
    many = {"velocity_mps": np.zeros((n, 2)), "object_id": [str(i) for i in range(n)]}
    truth = Truth.from_rows(
        BOXES.to_rows(), sequence=["s"] * n, frame=[0] * n, type=[1] * n, level=[1] * n, **many
    )
    columns = {"sequence": ["s"] * m, "frame": [0] * m, "type": [1] * m, "score": found.score}
    columns |= {"velocity_mps": np.zeros((m, 2)), "object_id": ["p"] * m, "unlabelled": [False] * m}
    result = detection(
        truth,
        Predictions.from_rows(found.to_rows(), **columns),
        iou_thresholds=[0.4] * 5,
        breakdowns=[ONE_SHARD],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    return result[0].ap


@BOX_CODERS
def test_one_frame_is_learnt_by_heart(box_coder: str) -> None:
    sample, detector = street(1), fresh(box_coder)
    batch = collate([sample], GRID)
    known, rule = make_targets(detector.head, batch.boxes), torch.optim.AdamW(detector.parameters(), lr=5e-3)
    for _ in range(90):
        rule.zero_grad()
        loss = losses(detector, detector(batch), batch, known, CRITERION)
        loss.total.backward()
        rule.step()
    found = boxes_of(detector, [sample])[0]
    assert precision(found) == 1.0
    first = np.array(
        [np.hypot(*(found.center_m[:, :2] - center[:2]).T).argmin() for center in BOXES.center_m]
    )
    turned = found.heading_rad[first] - BOXES.heading_rad
    assert np.cos(turned).min() > 0.9  # not half a turn either
    assert float(loss.distillation.detach()) < 0.05


@BOX_CODERS
def test_a_batch_gives_what_its_samples_give_alone(box_coder: str) -> None:
    detector, samples = network(box_coder), [street(1), street(2, BOXES[:2]), street(3, BOXES[:0])]
    together = output_of(detector, samples)
    for number, sample in enumerate(samples):
        alone = output_of(detector, [sample])
        for part in ("objectness", "residual", "cells"):
            np.testing.assert_allclose(getattr(together, part)[number], getattr(alone, part)[0], atol=1e-4)
    whole = losses_of(detector, samples)
    each = [losses_of(detector, [sample]) for sample in samples]
    for part in ("total", "objectness", "box", "heading", "distillation"):
        mean = torch.stack([getattr(one, part) for one in each]).mean()
        torch.testing.assert_close(getattr(whole, part), mean)


@BOX_CODERS
def test_the_order_of_points_does_not_matter(box_coder: str) -> None:
    detector, sample = network(box_coder), street(1)
    order = np.random.default_rng(0).permutation(len(sample.points))
    shuffled = replace(sample, points=sample.points[order])
    found, again = boxes_of(detector, [sample], 0.0)[0], boxes_of(detector, [shuffled], 0.0)[0]
    assert len(found.score) > 5
    np.testing.assert_allclose(found.to_rows(), again.to_rows(), atol=1e-3)
    np.testing.assert_allclose(found.score, again.score, atol=1e-5)


@BOX_CODERS
def test_the_same_step_gives_the_same_bytes(box_coder: str) -> None:
    def step() -> bytes:
        detector = network(box_coder)
        losses_of(detector, [street(1), street(2)]).total.backward()
        return b"".join(weight.grad.numpy().tobytes() for weight in detector.parameters())

    assert step() == step()


def test_features_are_one_linear_layer_on_the_cell_and_the_point() -> None:
    detector, sample = network(), street(1)
    batch = collate([street(2), sample], GRID)
    rows = torch.tensor([3, len(batch.points) - 1])
    with torch.inference_mode():
        cells = detector.backbone(detector.pillars(batch))
        features = detector.features(detector(batch), batch, rows)
    for row, one in zip(rows, features, strict=True):
        x, y, z, intensity, elongation, _ = batch.points[row]
        column, line = int((x + 12.8) // 0.8), int((y + 6.4) // 0.8)
        point = torch.stack([x / 12.8, y / 12.8, z / 2, intensity, elongation])
        value = torch.cat([cells[batch.of_sample[row], :, column, line], point])
        torch.testing.assert_close(one, detector.distillation_head(value), atol=1e-5, rtol=1e-4)


def test_older_points_are_told_from_new_ones() -> None:
    detector, sample = network(), street(1)
    new = replace(sample, points=sample.points * np.array([1, 1, 1, 1, 1, 0], dtype=np.float32))
    assert not torch.equal(output_of(detector, [sample]).objectness, output_of(detector, [new]).objectness)


@BOX_CODERS
def test_a_frame_without_points_or_boxes(box_coder: str) -> None:
    detector = network(box_coder)
    empty = Sample.from_points(np.zeros((0, 6), dtype=np.float32))
    assert torch.isfinite(losses_of(detector, [empty]).total)
    assert len(boxes_of(detector, [empty], 0.9)[0]) == 0


def test_distillation_adds_one_linear_layer() -> None:
    with_it, without = fresh("centers"), fresh("centers", distills=False)
    gone = set(with_it.state_dict()) - set(without.state_dict())
    assert gone == {"distillation_head.weight", "distillation_head.bias"}


def test_bf16_says_nearly_the_same() -> None:
    detector, batch = network(), collate([street(1)], GRID)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        half = detector(batch).objectness
    whole = output_of(detector, [street(1)]).objectness
    assert half.dtype == torch.float32
    assert np.corrcoef(half.numpy().ravel(), whole.numpy().ravel())[0, 1] > 0.99


def test_only_points_and_boxes_in_the_grid_count() -> None:
    far = np.array([[12.9, 0, 0, 0, 0, 0], [0, 0, 9, 0, 0, 0], [np.nan, 0, 0, 0, 0, 0]], dtype=np.float32)
    sample = street(1)
    more = Sample(
        np.concatenate([far, sample.points]),
        concat([BOXES, shifted(BOXES[:1], x=20)], Boxes),
        np.concatenate([[0, 1], sample.seen + 3]),
        np.concatenate([np.ones((2, FEATURE_DIM), dtype=np.float32), sample.feature]),
    )
    batch, expected = collate([more], GRID), collate([sample], GRID)
    assert torch.equal(batch.points, expected.points)
    assert torch.equal(batch.seen, expected.seen)
    assert torch.equal(batch.feature, expected.feature)
    np.testing.assert_array_equal(batch.boxes[0].to_rows(), expected.boxes[0].to_rows())


def test_a_grid_has_whole_eights_of_pillars() -> None:
    assert Grid((-50, 50), (-20, 20), (-3, 5), 0.32).shape == (320, 128)
    assert GRID.shape == (64, 32)


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (
            lambda: Detector(small_config(width=12), True),
            BadSetting,
            "model.width is 12, expected a multiple of 8",
        ),
        (
            lambda: Anchors(GRID, replace(SHIPPED.model.anchors, width_m=(1.9,))),
            BadSetting,
            "equally many values",
        ),
        (
            lambda: Anchors(GRID, replace(SHIPPED.model.anchors, length_m=(), width_m=(), height_m=())),
            BadSetting,
            "one at least",
        ),
        (lambda: Grid((5, -5), (0, 1), (0, 1), 0.3), BadInput, "grid x_m goes from 5 to -5"),
        (lambda: Grid((0, 5), (0, 1), (0, 1), float("nan")), BadInput, "pillar_m is nan"),
        (
            lambda: Sample.from_points(np.zeros((4, 5))),
            BadInput,
            r"points has shape \(4, 5\), expected \(4, 6\)",
        ),
    ],
)
def test_wrong_settings_are_named(make, error, words) -> None:  # noqa: ANN001
    with pytest.raises(error, match=words):
        make()


def test_a_pillar_is_the_maximum_over_its_points_by_a_plain_loop() -> None:
    torch.manual_seed(2)
    detector = Detector(small_config(), True)
    sample = street(1)
    batch = collate([street(2), sample], GRID)
    with torch.inference_mode():
        canvas = detector.pillars(batch)
        points = batch.points[batch.of_sample == 1]
        column, row = ((points[:, 0] + 12.8) / 0.4).long(), ((points[:, 1] + 6.4) / 0.4).long()
        for i, j in {(int(column[n]), int(row[n])) for n in (0, 500, 1700, 2000)}:
            here = points[(column == i) & (row == j)]
            own = here * torch.tensor([1, 1, 0.5, 1, 1, 10])
            own[:, 0] = (here[:, 0] + 12.8) / 0.4 - i - 0.5
            own[:, 1] = (here[:, 1] + 6.4) / 0.4 - j - 0.5
            center = torch.tensor([2 * i / 63 - 1, 2 * j / 31 - 1])
            shared = detector.pillars.pillar(torch.cat([own[:, :3].mean(dim=0), center]))
            maximum = detector.pillars.point(own).max(dim=0).values
            expected = torch.relu(detector.pillars.norm(maximum + shared))
            torch.testing.assert_close(canvas[1, :, i, j], expected, atol=1e-4, rtol=1e-4)
        filled = set(zip(column.tolist(), row.tolist(), strict=True))
        empty = next((i, j) for i in range(64) for j in range(32) if (i, j) not in filled)
        assert (canvas[1, :, empty[0], empty[1]] == 0).all()


@BOX_CODERS
def test_before_training_one_anchor_in_a_hundred_is_an_object(box_coder: str) -> None:
    output = output_of(fresh(box_coder), [street(1)])
    assert torch.sigmoid(output.objectness).mean().item() == pytest.approx(0.01, rel=0.2)
    assert output.residual.abs().max() < 1
