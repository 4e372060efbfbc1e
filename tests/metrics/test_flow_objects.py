"""The score of flow by object, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.metrics.flow_objects import ObjectFlows, is_right, object_flow_score


def flows(*rows: tuple[float, float, float, int, int]) -> ObjectFlows:
    """Objects of which each gives found and true speed along x, range, points, and points called moving."""
    found, true, range_m, points, moving = np.array(rows, dtype=np.float64).reshape(-1, 5).T
    zero = np.zeros(len(found))
    return ObjectFlows(
        predicted_mps=np.stack([found, zero, zero], axis=1),
        true_mps=np.stack([true, zero, zero], axis=1),
        range_m=range_m,
        points=points,
        moving_points=moving,
        interval_s=zero + 0.1,
    )


@pytest.mark.parametrize(
    ("found_mps", "true_mps", "right"),
    [
        (8.1, 10, True),
        (7.9, 10, False),
        (11.9, 10, True),
        (1.9, 1.0, True),
        (2.1, 1.0, False),
        (0.0, 0.9, False),
    ],
)
def test_right_is_within_a_fifth_or_a_tenth_of_a_metre_and_not_zero(
    found_mps: float, true_mps: float, right: bool
) -> None:
    assert is_right(flows((found_mps, true_mps, 10, 50, 50)))[0] == right


def test_right_looks_at_the_direction_but_not_at_the_height() -> None:
    row = flows((10, 10, 10, 50, 50))
    assert not is_right(ObjectFlows(row.predicted_mps[:, [1, 0, 2]], *list(vars(row).values())[1:]))[0]
    assert is_right(ObjectFlows(row.predicted_mps + (0, 0, 9), *list(vars(row).values())[1:]))[0]


def test_shares_by_range_and_speed() -> None:
    found = flows(
        (10, 10, 5, 30, 30),
        (0, 10, 5, 30, 0),
        (2, 2, 60, 100, 100),
        (0, 8, 5, 29, 0),  # too few points
        (0.0, 0.0, 8, 100, 0),
        (3.0, 0.1, 8, 50, 40),
        (3.0, 0.5, 8, 50, 40),  # neither moves nor stands
    )
    score = object_flow_score(found, moving_mps=1.0, range_edges_m=[30, 50], speed_edges_mps=[3])
    rows = {share.name: (share.objects, share.right, share.standing) for share in score.moving}
    assert rows == {
        "all": (3, 2 / 3, 1 / 3),
        "0 to 30 m": (2, 0.5, 0.5),
        "from 50 m": (1, 1.0, 0.0),
        "0 to 3 m/s": (1, 1.0, 0.0),
        "from 3 m/s": (2, 0.5, 0.5),
    }
    assert (score.standing_objects, score.called_moving) == (2, 0.5)
    assert score.points_called_moving == pytest.approx(40 / 150)
    assert score.speed_error_mps == 0


def test_nothing_has_no_score() -> None:
    score = object_flow_score(flows(), moving_mps=1.0, range_edges_m=[30], speed_edges_mps=[3])
    assert score.moving[0].objects == 0
    assert np.isnan(score.moving[0].right)
    assert np.isnan(score.called_moving)
    assert score.points_called_moving == 0
