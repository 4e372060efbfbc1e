"""What a third sweep adds: it confirms, contradicts, and shows what the second does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.flow.rigid import estimate_rigid_flow
from upvl_cli.perception.flow.search import FlowState
from upvl_cli.perception.flow.spread import rest_where_explained
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.stages.flow import FlowConfig

CONFIG = load(FlowConfig, Path(__file__).parents[3] / "stages" / "flow.toml").rigid
DT_S = 0.1


def face(corner: tuple[float, ...], *edges: tuple[float, ...], count: int, seed: int) -> np.ndarray:
    """Random points of the parallelogram that two edges span, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (count, 2)) @ np.array(edges) + corner + rng.normal(0, 0.01, (count, 3))


def side(x_m: float, seed: int, length_m: float = 4.0) -> np.ndarray:
    """The side of a car that passes: nothing but a plane along its way."""
    return face((x_m, 5, 0.3), (length_m, 0, 0), (0, 0, 1.2), count=900, seed=seed)


def corner(x_m: float, y_m: float, seed: int) -> np.ndarray:
    """Side and rear of a car."""
    return np.concatenate(
        [
            face((x_m, y_m, 0.3), (4, 0, 0), (0, 0, 1.2), count=300, seed=seed),
            face((x_m, y_m, 0.3), (0, 1.8, 0), (0, 0, 1.2), count=150, seed=seed + 1000),
        ]
    )


def walker(x_m: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(np.pi / 2, 3 * np.pi / 2, 150), rng.uniform(0.3, 1.7, 150)
    return np.stack([x_m + 0.25 * np.cos(angle), 9 + 0.25 * np.sin(angle), z], axis=1)


def flow(now: np.ndarray, later: np.ndarray, before: np.ndarray | None) -> np.ndarray:
    others = [OtherSweep(later, DT_S)] + ([] if before is None else [OtherSweep(before, -2 * DT_S)])
    return np.asarray(estimate_rigid_flow(now, others, CONFIG))


@pytest.mark.parametrize("speed_mps", [6.0, 8.0, 15.0])
def test_a_side_that_slides_along_itself_moves_where_a_third_sweep_confirms(speed_mps: float) -> None:
    now, later, before = (side(10 + speed_mps * t, n) for n, t in enumerate((0, DT_S, -2 * DT_S)))
    found = flow(now, later, before)
    assert abs(found[:, 0].mean() - speed_mps) < max(0.2 * speed_mps, 1.0)
    assert np.abs(flow(now, later, None)).max() == 0, "two sweeps alone may show a wall"


@pytest.mark.parametrize("back_m", [0.0, 0.8], ids=["stood before", "came from the other side"])
def test_a_side_whose_ends_the_third_sweep_contradicts_stands(back_m: float) -> None:
    assert np.abs(flow(side(10, 0), side(10.8, 1), side(10 + back_m, 2))).max() == 0


def test_a_side_of_which_more_and_more_comes_into_view_stands() -> None:
    """One end stays, the other goes on: a wall behind a car that leaves."""
    assert np.abs(flow(side(10, 0, 4.0), side(10, 1, 4.8), side(10, 2, 2.4))).max() == 0


def test_what_the_third_sweep_has_at_the_same_place_does_not_move() -> None:
    """In the second sweep a copy of it appears 1 m on, and it is hidden."""
    now, copy, before = corner(12, 4, 0), corner(13, 4, 1), corner(12, 4, 2)
    assert np.abs(flow(now, copy, before)).max() == 0
    assert np.abs(flow(now, copy, None)[:, 0].mean() - 10) < 1


def test_a_motion_that_the_third_sweep_fits_worse_than_rest_is_not_taken() -> None:
    """Before it was 0.3 m ahead, not 2 m behind: it rolls back, and what appears 1 m on is another thing."""
    now, copy, before = corner(12, 4, 0), corner(13, 4, 1), corner(12.3, 4, 2)
    assert flow(now, copy, before)[:, 0].max() < 1.0


def test_what_is_hidden_in_the_second_sweep_moves_by_the_third() -> None:
    post = walker(30, 5)
    now, before = (np.concatenate([corner(x_m, 4, n), post]) for n, x_m in ((0, 12), (1, 10.4)))
    found = flow(now, post, before)
    np.testing.assert_allclose(found[:450].mean(axis=0), [8, 0, 0], atol=0.5)
    assert np.abs(found[450:]).max() == 0


def test_a_slow_walker_moves_by_the_third_sweep() -> None:
    """At 0.8 m/s he is 0.08 m on in the second sweep, and 0.16 m back in the third."""
    now, later, before = (walker(12 + 0.8 * t, n) for n, t in enumerate((0, DT_S, -2 * DT_S)))
    found = flow(now, later, before)
    assert abs(found[:, 0].mean() - 0.8) < 0.4


def test_the_rest_of_a_thing_that_moves_goes_with_it() -> None:
    """Two far parts of a truck: of the smaller the second sweep has too few points for a motion of its own."""
    part = face((20, 6.7, 0.6), (0, 0.5, 0), (0, 0, 1), count=7, seed=9)
    now, later = (np.concatenate([corner(x_m, 4, 0), part + (x_m - 20, 0, 0)]) for x_m in (20, 21.2))
    found = flow(now, later, None)
    np.testing.assert_allclose(found[-7:].mean(axis=0), [12, 0, 0], atol=0.5)
    alone = replace(CONFIG, spread_m=0.0)
    found = np.asarray(estimate_rigid_flow(now, [OtherSweep(later, DT_S)], alone))
    assert np.abs(found[-7:]).max() == 0


@pytest.mark.parametrize(
    ("resting", "remaining", "rests"), [(30, 40, True), (30, 70, False), (15, 20, False)]
)
def test_the_part_that_stands_of_a_mixed_component_rests(resting: int, remaining: int, rests: bool) -> None:
    """Of 100 points so many are explained at rest alone, of so many that the motion does not explain."""
    state = FlowState.at_rest(corner(12, 4, 0), corner(13, 4, 0), 3.0, CONFIG.surface)
    state.shift_m[:100] = (1.0, 0, 0)
    component = np.repeat([0, -1], [100, 350])
    at = np.arange(450)
    remains, is_residual = at < remaining, at >= resting
    rest_where_explained(state, component, is_residual, remains, CONFIG.evidence)
    assert (state.shift_m[:resting] == 0).all() == rests
    assert (state.shift_m[resting:100] == (1.0, 0, 0)).all()
