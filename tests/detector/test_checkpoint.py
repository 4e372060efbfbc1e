"""What is kept of training comes back as it was, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import SMALL

from upvl_cli.detector.checkpoint import State, keep, packed, rebuilt, resume
from upvl_cli.detector.model import Detector


def state() -> State:
    return State(
        step=4,
        model={"a.b": torch.arange(3.0)},
        moments={"exp_avg/a.b": torch.ones(3), "step/a.b": torch.tensor(4.0)},
        best={"a.b": torch.zeros(3)},
        lowest=0.1,
        curve=[[0.1, 6, 1, 2, 3, 0.0]] * 4,
        checks=[[4, 0.1]],
        found={7: np.arange(14.0).reshape(2, 7), 2: np.ones((1, 7))},
    )


def test_all_of_it_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "c.safetensors"
    keep(path, state(), "mine")
    again = resume(path, "mine")
    assert again is not None
    assert (again.step, again.lowest, again.curve, again.checks) == (4, 0.1, state().curve, state().checks)
    for part in ("model", "moments", "best"):
        assert {n: t.tolist() for n, t in getattr(again, part).items()} == {
            n: t.tolist() for n, t in getattr(state(), part).items()
        }
    assert {n: b.tolist() for n, b in again.found.items()} == {
        n: b.tolist() for n, b in state().found.items()
    }


def test_an_empty_one_too(tmp_path: Path) -> None:
    keep(tmp_path / "c", State(), "mine")
    assert resume(tmp_path / "c", "mine") == State()


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-10], lambda b: b"", lambda b: b"x" * len(b), lambda b: b[:8]]
)
def test_what_is_not_whole_or_not_mine_is_passed_over(tmp_path: Path, damage) -> None:  # noqa: ANN001
    path = tmp_path / "c"
    assert resume(path, "mine") is None
    keep(path, state(), "mine")
    assert resume(path, "other") is None
    path.write_bytes(damage(path.read_bytes()))
    assert resume(path, "mine") is None


def test_a_network_comes_back_from_its_bytes() -> None:
    detector = Detector(SMALL, 8, "centres", True)
    again = rebuilt(packed(detector.state_dict()), SMALL, 8, "centres", True)
    assert not again.training
    assert all(torch.equal(a, b) for a, b in zip(detector.parameters(), again.parameters(), strict=True))
    with pytest.raises(RuntimeError):
        rebuilt(packed(detector.state_dict()), SMALL, 8, "anchors", False)
