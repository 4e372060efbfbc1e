"""Which places stand for which boxes, and the numbers that say a box."""

from __future__ import annotations

from dataclasses import replace
from math import cos, exp, log, pi, sin

import numpy as np
import pytest
from scenes import BOXES, CODERS, SHIPPED, shifted, small_head

from upvl_cli.detector.assignment import assign_by_overlap
from upvl_cli.detector.heads.base import decode, encode
from upvl_cli.detector.targets import make_targets
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.types import Boxes, concat, empty

HEADS = pytest.mark.parametrize("box_coder", CODERS)
POSITIVE_IOU, NEGATIVE_IOU = 0.35, 0.25


def random_boxes(seed: int, count: int) -> Boxes:
    """From walkers to buses, some over each other, some over the edge of the grid."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform((-12.8, -6.4, 0), (12.8, 6.4, 2), (count, 3))
    return Boxes(centre, rng.uniform(0.4, 12, (count, 3)), rng.uniform(-pi, pi, count))


def slowly(
    anchors: Boxes, boxes: Boxes, positive_iou: float = POSITIVE_IOU, negative_iou: float = NEGATIVE_IOU
) -> tuple[list[float], dict[int, int]]:
    """The rules one by one, on the whole matrix of overlaps."""
    iou = iou_bev(anchors, boxes)
    weight, owner = [], {}
    for anchor, row in enumerate(iou):
        best = max(row, default=0)
        weight.append(0.0 if negative_iou <= best < positive_iou else 1.0)
        if best >= positive_iou:
            owner[anchor] = list(row).index(best)
    for box, column in enumerate(iou.T):
        distance = [np.hypot(*(center[:2] - boxes.center_m[box, :2])) for center in anchors.center_m]
        anchor = int(np.argmax(column)) if max(column) > 0 else int(np.argmin(distance))
        owner[anchor], weight[anchor] = box, 1.0
    return weight, owner


@pytest.mark.parametrize("seed", range(4))
def test_assignment_is_that_of_a_plain_loop(seed: int) -> None:
    anchors = small_head("anchors").anchors[seed::3]
    boxes = random_boxes(seed, 8)
    boxes.size_lwh_m[0, :2] = 0.02, 30  # overlaps everything a little
    boxes.center_m[1, :2] = 300, 0  # overlaps nothing
    weight, owner = slowly(anchors, boxes)
    given = assign_by_overlap(anchors, boxes, POSITIVE_IOU, NEGATIVE_IOU)
    assert given.weight.tolist() == weight
    assert dict(zip(given.anchor.tolist(), given.box.tolist(), strict=True)) == owner
    assert given.anchor.tolist() == sorted(owner)


def test_an_anchor_on_a_box_stands_for_it() -> None:
    head = small_head("anchors")
    anchor = 8 * 100 + 3  # a truck's anchor that lies across
    given = head.assign(head.anchors[anchor : anchor + 1])
    assert given.box[given.anchor == anchor].tolist() == [0]
    assert given.weight[anchor] == 1


@HEADS
def test_every_box_has_a_place(box_coder: str) -> None:
    given = small_head(box_coder).assign(BOXES)
    assert set(given.box) == set(range(len(BOXES)))
    assert (given.weight[given.anchor] == 1).all()


@HEADS
def test_no_boxes(box_coder: str) -> None:
    given = small_head(box_coder).assign(BOXES[:0])
    assert (given.weight == 1).all()
    assert len(given.anchor) == len(given.box) == 0


@HEADS
def test_numbers_say_the_box_again(box_coder: str) -> None:
    head = small_head(box_coder)
    boxes = random_boxes(1, 200)
    boxes.heading_rad[:4] = 0, pi / 2, -pi / 2, -pi
    anchors = head.anchors[np.random.default_rng(2).integers(0, len(head.anchors), 200)]
    again = decode(head, anchors, encode(head, anchors, boxes))
    np.testing.assert_allclose(again.center_m, boxes.center_m, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.size_lwh_m, boxes.size_lwh_m, rtol=1e-12, atol=1e-12)
    turn = again.heading_rad - boxes.heading_rad
    np.testing.assert_allclose([np.sin(turn), np.cos(turn) - 1], 0, atol=1e-12)
    assert (np.abs(again.heading_rad) <= pi).all()


@HEADS
def test_targets_say_the_boxes_of_each_sample(box_coder: str) -> None:
    head = small_head(box_coder)
    known = make_targets(head, [BOXES, empty(Boxes), BOXES[3:4]])
    assert known.weight.shape == (3, len(head.anchors))
    for sample, boxes in ((0, BOXES), (2, BOXES[3:4])):
        mine = known.sample == sample
        decoded = decode(head, head.anchors[known.anchor[mine].numpy()], known.residual[mine].numpy())
        nearest = np.abs(decoded.to_rows()[:, None] - boxes.to_rows()).sum(axis=2)
        assert set(nearest.argmin(axis=1)) == set(range(len(boxes)))
        np.testing.assert_allclose(nearest.min(axis=1), 0, atol=1e-4)
    assert not (known.sample == 1).any()


@HEADS
def test_places_lie_over_the_grid_by_x_then_y(box_coder: str) -> None:
    head = small_head(box_coder)
    assert len(head.anchors) == 32 * 16 * head.anchors_per_cell
    cells = head.anchors.center_m[:: head.anchors_per_cell, :2]
    np.testing.assert_allclose(cells[[0, 1, 16, -1]], [[-12.4, -6], [-12.4, -5.2], [-11.6, -6], [12.4, 6]])


def test_a_cell_beside_the_middle_is_excused_by_how_near_it_is() -> None:
    head = small_head("centers")
    box = Boxes.from_rows(
        np.array([[0.4, 0.4, 0.8, 4.0, 2.0, 1.6, 0.0]])
    )  # its middle is that of cell (16, 8)
    weight = head.assign(box).weight.reshape(32, 16)
    assert weight[16, 8] == 1
    assert weight[17, 8] < weight[18, 8] < weight[19, 8] < 1  # along it
    assert weight[17, 8] < weight[16, 9]  # a step across leaves it sooner than a step along
    assert weight[26, 8] > 0.999


def test_thresholds_belong_to_the_side_that_the_settings_name() -> None:
    anchors = small_head("anchors").anchors
    boxes = BOXES[:1]
    overlap = iou_bev(anchors, boxes)[:, 0]
    best, second, third = np.argsort(-overlap, kind="stable")[:3]
    assert overlap[second] > overlap[third] > 0
    at = assign_by_overlap(anchors, boxes, positive_iou=overlap[second], negative_iou=overlap[third])
    assert at.anchor.tolist() == sorted([best, second])  # from positive_iou on
    assert at.weight[third] == 0  # from negative_iou on it is ignored
    above = assign_by_overlap(
        anchors, boxes, positive_iou=overlap[second] * 1.001, negative_iou=overlap[third] * 1.001
    )
    assert above.anchor.tolist() == [best]
    assert above.weight[second] == 0
    assert above.weight[third] == 1


def test_of_two_boxes_on_one_anchor_the_later_has_it() -> None:
    for box_coder in CODERS:
        head = small_head(box_coder)
        twice = concat([BOXES[:1], BOXES[:1]], Boxes)
        assert set(head.assign(twice).box) in ({1}, {0, 1})
        alone = head.assign(BOXES[:1])
        assignment = head.assign(twice)
        best = iou_bev(head.anchors[assignment.anchor], BOXES[:1])[:, 0].argmax()
        assert assignment.box[best] == 1
        assert assignment.anchor.tolist() == alone.anchor.tolist()


def test_an_anchor_takes_the_box_that_it_overlaps_most() -> None:
    anchor = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 2, 1, 0]]))
    anchors = concat([anchor, shifted(anchor, x=0.2), shifted(anchor, x=1.0)], Boxes)
    first, last = anchors[:1], anchors[2:]
    assert assign_by_overlap(anchors, concat([first, last], Boxes), 0.35, 0.25).box.tolist() == [0, 0, 1]
    assert assign_by_overlap(anchors, concat([last, first], Boxes), 0.35, 0.25).box.tolist() == [1, 1, 0]


def test_residuals_by_hand() -> None:
    head = small_head("anchors")
    anchor = Boxes.from_rows(np.array([[1.0, 2, 3, 4, 3, 2, 0.5]]))  # its diagonal is 5
    box = Boxes.from_rows(np.array([[6.0, -8, 4, 8, 1.5, 2, 0.7]]))
    np.testing.assert_allclose(encode(head, anchor, box), [[1, -2, 0.5, log(2), -log(2), 0, 0.2, 0]])


@pytest.mark.parametrize(
    ("heading", "angle", "looks_back"),
    [
        (0.5, 0.0, 0),
        (0.5 + 0.4, 0.4, 0),
        (0.5 + pi - 0.3, -0.3, 1),
        (0.5 - 2.0, pi - 2.0, 1),
        (0.5 + 1.5, 1.5, 0),
        (0.5 + 2 * pi + 0.1, 0.1, 0),
    ],
)
def test_a_heading_is_an_angle_and_a_direction(heading: float, angle: float, looks_back: int) -> None:
    head = small_head("anchors")
    anchor = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 2, 1, 0.5]]))
    box = replace(anchor, heading_rad=np.array([heading]))
    code = head.encode_heading(anchor, box)
    np.testing.assert_allclose(code, [[angle, looks_back]], atol=1e-12)
    # The network gives logits: above 0 the box looks the other way.
    for logit in (0.01, -0.01):
        decoded = head.decode_heading(anchor, np.array([[angle, logit]]))[0]
        turn = heading - decoded + (pi if (logit > 0) != bool(looks_back) else 0)
        assert abs(np.sin(turn / 2)) < 1e-12


def test_center_cells_and_weights_by_a_plain_loop() -> None:
    head, config = small_head("centers"), SHIPPED.model.centers
    boxes = concat([BOXES, shifted(BOXES[:1], x=0.01)], Boxes)
    assignment = head.assign(boxes)
    expected = {}
    for number, (x, y, _) in enumerate(boxes.center_m):
        expected[int((x + 12.8) // 0.8) * 16 + int((y + 6.4) // 0.8)] = number
    assert dict(zip(assignment.anchor.tolist(), assignment.box.tolist(), strict=True)) == expected
    for cell in (0, 77, 200, 300, 511):
        weight = 1.0
        for box in boxes.to_rows():
            dx, dy = head.anchors.center_m[cell, :2] - box[:2]
            along, across = dx * cos(box[6]) + dy * sin(box[6]), dy * cos(box[6]) - dx * sin(box[6])
            square = (along / box[3]) ** 2 + (across / box[4]) ** 2
            weight = min(weight, (1 - exp(-square / (2 * config.heatmap_sigma**2))) ** 4)
        if cell not in expected:
            assert assignment.weight[cell] == pytest.approx(weight, rel=1e-5)
    outside = head.assign(shifted(BOXES[:1], x=100))
    assert outside.anchor // 16 == 31  # a box beyond the grid stands in its last cell


def test_anchors_stand_on_the_ground_in_all_sizes_and_two_headings() -> None:
    head, config = small_head("anchors"), SHIPPED.model.anchors
    cell = head.anchors[:8]
    assert head.anchors_per_cell == 8
    np.testing.assert_allclose(cell.center_m[:, 2], cell.size_lwh_m[:, 2] / 2)
    np.testing.assert_allclose(cell.heading_rad, [0, pi / 2] * 4)
    sizes = np.column_stack([config.length_m, config.width_m, config.height_m])
    np.testing.assert_allclose(cell.size_lwh_m, np.repeat(sizes, 2, axis=0))
    rest = SHIPPED.model.centers
    np.testing.assert_allclose(
        small_head("centers").anchors.to_rows()[5, 2:],
        [rest.center_z_m, rest.length_m, rest.width_m, rest.height_m, 0],
    )


def test_an_anchor_between_two_boxes_takes_the_first() -> None:
    anchor = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 2, 1, 0]]))
    anchors = concat([anchor, shifted(anchor, x=1), shifted(anchor, x=2)], Boxes)
    overlap = iou_bev(anchors, anchors[[0, 2]])[1]
    assert overlap[0] == overlap[1]
    assert assign_by_overlap(anchors, anchors[[0, 2]], 0.35, 0.25).box.tolist() == [0, 0, 1]


def test_anchors_beside_a_box_are_ignored_on_all_sides() -> None:
    box = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 4, 1, 0]]))
    # By 2.3 m aside 1.7 m of 4 m are common: an overlap of 0.27.
    sides = [shifted(box, x=-2.3), shifted(box, y=-2.3), box, shifted(box, y=2.3), shifted(box, x=2.3)]
    assert assign_by_overlap(concat(sides, Boxes), box, 0.35, 0.25).weight.tolist() == [0, 0, 1, 0, 0]
    long = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 1, 1, 0]]))
    ends = concat([shifted(long, x=-2.3), long, shifted(long, x=2.3)], Boxes)
    assert assign_by_overlap(ends, long, 0.35, 0.25).weight.tolist() == [0, 1, 0]


@pytest.mark.parametrize(("positive_iou", "negative_iou"), [(0.35, 0.25), (0.6, 0.45), (0.9, 0.9)])
def test_assignment_to_anchors_of_any_heading_is_that_of_a_plain_loop(
    positive_iou: float, negative_iou: float
) -> None:
    boxes = random_boxes(10, 8)
    near = [shifted(boxes, x=0.1 * step, y=-0.05 * step) for step in range(5)]
    anchors = concat([random_boxes(1, 100), *near], Boxes)
    anchors = anchors[np.argsort(anchors.center_m[:, 0])]
    weight, owner = slowly(anchors, boxes, positive_iou, negative_iou)
    given = assign_by_overlap(anchors, boxes, positive_iou, negative_iou)
    assert given.weight.tolist() == weight
    assert dict(zip(given.anchor.tolist(), given.box.tolist(), strict=True)) == owner
    assert len(owner) > len(boxes) or positive_iou == 0.9


def test_a_box_takes_an_anchor_that_it_hardly_touches_before_a_nearer_one_that_it_does_not() -> None:
    box = Boxes.from_rows(np.array([[0.0, 0, 0, 4, 4, 1, pi / 4]]))  # a corner reaches 2.83 m along x
    beside = Boxes.from_rows(np.array([[3.5, 3.5, 0, 0.1, 0.1, 1, 0]]))
    anchors = concat([beside, shifted(box, x=5.2)], Boxes)
    assert 0 < iou_bev(anchors, box)[1, 0] < 0.01
    assert assign_by_overlap(anchors, box, 0.35, 0.25).anchor.tolist() == [1]
