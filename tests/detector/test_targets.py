"""Which places stand for which boxes, and the numbers that say a box."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
import torch
from scenes import BOXES, SMALL

from upvl_cli.detector.anchors import Anchors
from upvl_cli.detector.centres import Centres
from upvl_cli.detector.head import decode, encode
from upvl_cli.detector.targets import NEGATIVE_IOU, POSITIVE_IOU, assign, targets
from upvl_cli.geometry.iou import iou_bev

HEADS = pytest.mark.parametrize("kind", [Anchors, Centres])


def random_boxes(seed: int, count: int) -> np.ndarray:
    """From walkers to buses, some over each other, some over the edge of the grid."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform((-12.8, -6.4, 0), (12.8, 6.4, 2), (count, 3))
    return np.column_stack([centre, rng.uniform(0.4, 12, (count, 3)), rng.uniform(-pi, pi, count)])


def slowly(anchors: np.ndarray, boxes: np.ndarray) -> tuple[list[float], dict[int, int]]:
    """The rules one by one, on the whole matrix of overlaps."""
    iou = iou_bev(anchors, boxes)
    weight, owner = [], {}
    for place, row in enumerate(iou):
        best = max(row, default=0)
        weight.append(0.0 if NEGATIVE_IOU <= best < POSITIVE_IOU else 1.0)
        if best >= POSITIVE_IOU:
            owner[place] = list(row).index(best)
    for box, column in enumerate(iou.T):
        distance = [np.hypot(*(anchor[:2] - boxes[box, :2])) for anchor in anchors]
        place = int(np.argmax(column)) if max(column) > 0 else int(np.argmin(distance))
        owner[place], weight[place] = box, 1.0
    return weight, owner


@pytest.mark.parametrize("seed", range(4))
def test_assignment_is_that_of_a_plain_loop(seed: int) -> None:
    anchors = Anchors(SMALL).places[seed::3]
    boxes = random_boxes(seed, 8)
    boxes[0, 3:5] = 0.02, 30  # overlaps everything a little
    boxes[1, :2] = 300, 0  # overlaps nothing
    weight, owner = slowly(anchors, boxes)
    given = assign(anchors, boxes)
    assert given.weight.tolist() == weight
    assert dict(zip(given.place.tolist(), given.box.tolist(), strict=True)) == owner
    assert given.place.tolist() == sorted(owner)


def test_an_anchor_on_a_box_stands_for_it() -> None:
    head = Anchors(SMALL)
    place = 8 * 100 + 3  # a truck's anchor that lies across
    given = head.assign(head.places[place : place + 1])
    assert given.box[given.place == place].tolist() == [0]
    assert given.weight[place] == 1


@HEADS
def test_every_box_has_a_place(kind: type[Anchors] | type[Centres]) -> None:
    given = kind(SMALL).assign(BOXES)
    assert set(given.box) == set(range(len(BOXES)))
    assert (given.weight[given.place] == 1).all()


@HEADS
def test_no_boxes(kind: type[Anchors] | type[Centres]) -> None:
    given = kind(SMALL).assign(BOXES[:0])
    assert (given.weight == 1).all()
    assert len(given.place) == len(given.box) == 0


@HEADS
def test_numbers_say_the_box_again(kind: type[Anchors] | type[Centres]) -> None:
    head = kind(SMALL)
    boxes = random_boxes(1, 200)
    boxes[:4, 6] = 0, pi / 2, -pi / 2, -pi
    places = head.places[np.random.default_rng(2).integers(0, len(head.places), 200)]
    again = decode(head, places, encode(head, places, boxes))
    np.testing.assert_allclose(again[:, :6], boxes[:, :6], rtol=1e-12, atol=1e-12)
    turn = again[:, 6] - boxes[:, 6]
    np.testing.assert_allclose([np.sin(turn), np.cos(turn) - 1], 0, atol=1e-12)
    assert (np.abs(again[:, 6]) <= pi).all()


@HEADS
def test_targets_say_the_boxes_of_each_sample(kind: type[Anchors] | type[Centres]) -> None:
    head = kind(SMALL)
    known = targets(head, [torch.from_numpy(BOXES), torch.zeros(0, 7), torch.from_numpy(BOXES[3:4])])
    assert known.weight.shape == (3, len(head.places))
    for sample, boxes in ((0, BOXES), (2, BOXES[3:4])):
        mine = known.sample == sample
        said = decode(head, head.places[known.place[mine].numpy()], known.residual[mine].numpy())
        nearest = np.abs(said[:, None] - boxes).sum(axis=2)
        assert set(nearest.argmin(axis=1)) == set(range(len(boxes)))
        np.testing.assert_allclose(nearest.min(axis=1), 0, atol=1e-4)
    assert not (known.sample == 1).any()


@HEADS
def test_places_lie_over_the_grid_by_x_then_y(kind: type[Anchors] | type[Centres]) -> None:
    head = kind(SMALL)
    assert len(head.places) == 32 * 16 * head.each_cell
    cells = head.places[:: head.each_cell, :2]
    np.testing.assert_allclose(cells[[0, 1, 16, -1]], [[-12.4, -6], [-12.4, -5.2], [-11.6, -6], [12.4, 6]])


def test_a_cell_beside_the_middle_is_excused_by_how_near_it_is() -> None:
    head = Centres(SMALL)
    box = np.array([0.4, 0.4, 0.8, 4.0, 2.0, 1.6, 0.0])  # its middle is that of cell (16, 8)
    weight = head.assign(box[None]).weight.reshape(32, 16)
    assert weight[16, 8] == 1
    assert weight[17, 8] < weight[18, 8] < weight[19, 8] < 1  # along it
    assert weight[17, 8] < weight[16, 9]  # a step across leaves it sooner than a step along
    assert weight[26, 8] > 0.999
