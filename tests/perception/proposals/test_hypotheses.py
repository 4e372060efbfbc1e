"""Clusters of several radii in one list, and which of them hold the same points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from proposal_scene import NO_HISTORY, all_candidates, block, changed, spot, sweep

from upvl_cli.perception.proposals.cluster_fits import ClusterFits
from upvl_cli.perception.proposals.hypotheses import join_hypotheses
from upvl_cli.perception.proposals.propose import Proposals, propose
from upvl_cli.types import Boxes


def labelled(*label: int) -> Proposals:
    """Boxes of nothing around points with these labels."""
    total = max(label, default=-1) + 1
    count = np.bincount([number for number in label if number >= 0], minlength=total)
    boxes = Boxes.from_rows(np.arange(7.0 * total).reshape(-1, 7))
    return Proposals(boxes, np.zeros((total, 3)), count, np.array(label), {})


def test_each_hypothesis_is_that_of_its_radius_alone() -> None:
    pair = sweep((block(10, 3, (2, 1, 1)), (5.0, 0.0)), (block(12.7, 3, (2, 1, 1)), (5.0, 0.0)))
    seen = all_candidates(pair)
    both = propose(seen, NO_HISTORY, changed(clustering__eps_m=(0.5, 1.0)))
    assert [len(found.boxes) for found in both] == [2, 1]
    for eps_m, found in zip((0.5, 1.0), both, strict=True):
        (alone,) = propose(seen, NO_HISTORY, changed(clustering__eps_m=(eps_m,)))
        np.testing.assert_array_equal(found.boxes.to_rows(), alone.boxes.to_rows())
        np.testing.assert_array_equal(found.box_of_point, alone.box_of_point)
        np.testing.assert_array_equal(found.velocity_mps, alone.velocity_mps)


def test_a_box_of_nearly_the_same_points_is_a_duplicate() -> None:
    earlier = labelled(0, 0, 0, 0, 1, 1, -1, -1)
    later = labelled(0, 0, 0, 0, 0, -1, 1, 1)  # box 0 has four of its five points in common: 0.8
    number = np.arange(10, 18)
    found = join_hypotheses([earlier, later], number, duplicate_iou=0.8)
    assert found.hypothesis.tolist() == [0, 0, 1, 1]
    assert found.duplicate_of.tolist() == [-1, -1, 0, -1]
    assert found.num_points.tolist() == [4, 2, 5, 2]
    assert found.point_index.count.tolist() == [4, 2, 5, 2]
    assert found.point_index.values.tolist() == [10, 11, 12, 13, 14, 15, 10, 11, 12, 13, 14, 16, 17]
    assert join_hypotheses([earlier, later], number, duplicate_iou=0.81).duplicate_of.tolist() == [-1] * 4


def test_the_closest_of_all_earlier_hypotheses_is_named() -> None:
    first, second, third = labelled(0, 0, 0, 0, -1), labelled(0, 0, 0, 0, 0), labelled(0, 0, 0, 0, 0)
    found = join_hypotheses([first, second, third], np.arange(5), duplicate_iou=0.5)
    assert found.duplicate_of.tolist() == [-1, 0, 1]


def test_hypotheses_of_nothing() -> None:
    found = join_hypotheses([labelled(-1, -1), labelled(-1, -1)], np.arange(2), duplicate_iou=0.9)
    assert len(found.boxes) == len(found.duplicate_of) == len(found.point_index.count) == 0


def test_a_point_may_be_in_a_box_of_each_hypothesis() -> None:
    seen = all_candidates(sweep((spot(8.05, 0.05), (5.0, 0.0)), (spot(8.05, 0.75), (5.0, 0.0))))
    seen = replace(seen, is_candidate=np.ones(len(seen.xyz_m), bool))
    both = propose(seen, NO_HISTORY, changed(clustering__eps_m=(0.5, 1.0)))
    found = join_hypotheses(both, np.arange(len(seen.xyz_m)), duplicate_iou=0.9)
    assert found.point_index.count.tolist() == [6, 6, 12]
    assert np.bincount(found.point_index.values).tolist() == [2] * 12


def test_equal_points_have_the_box_of_their_velocity() -> None:
    fits = ClusterFits(sweep((block(10, 3, (2, 1, 1)), (5.0, 0.0))), changed())
    label = np.zeros(len(fits.sweep.xyz_m), np.int64)
    headings = [fits.boxes(label, np.array([[*way, 0.0]])).heading_rad[0] for way in ((5, 0), (0, 5), (5, 0))]
    np.testing.assert_allclose(headings, [0, np.pi / 2, 0])
