"""Which sweeps a sweep is compared with, by hand for each place in a drive."""

from __future__ import annotations

import pytest

from upvl_cli.perception.flow.sweeps import other_steps


@pytest.mark.parametrize(
    ("step", "others"), [(0, (1, 2)), (1, (2, 3)), (2, (3, 0)), (3, (2, 1))], ids=["first", "2", "3", "last"]
)
def test_flow_leads_to_the_next_sweep_and_the_one_before_confirms(step: int, others: tuple[int, ...]) -> None:
    assert other_steps([0.0, 0.1, 0.2, 0.3], step, 0.08, 0.18) == others


@pytest.mark.parametrize(
    ("step", "others"), [(0, (2, 4)), (4, (6, 0)), (8, (6, 4)), (9, (7, 5)), (1, (3, 5))]
)
def test_at_a_high_rate_it_leads_over_several(step: int, others: tuple[int, ...]) -> None:
    assert other_steps([0.05 * n for n in range(10)], step, 0.08, 0.18) == others


def test_after_a_gap_it_leads_to_the_sweep_behind_the_gap() -> None:
    assert other_steps([0.0, 0.05, 0.9, 1.0], 1, 0.08, 0.18) == (2, 3)
    assert other_steps([0.0, 0.05, 0.9, 1.0], 2, 0.08, 0.18) == (3, 1)


@pytest.mark.parametrize(
    ("times_s", "step", "others"),
    [
        ([0.0], 0, ()),
        ([0.0, 0.1], 0, (1,)),
        ([0.0, 0.1], 1, (0,)),
        ([0.0, 0.03, 0.05], 0, (2,)),
        ([0.0, 0.03, 0.05], 1, (0,)),
    ],
)
def test_a_short_drive_gives_what_it_has(times_s: list[float], step: int, others: tuple[int, ...]) -> None:
    assert other_steps(times_s, step, 0.08, 0.18) == others
