"""What is kept of training comes back as it was, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import small_config

from upvl_cli.detector.checkpoint import (
    TrainState,
    load_checkpoint,
    pack_config,
    pack_weights,
    save_checkpoint,
    unpack_config,
    unpack_detector,
)
from upvl_cli.detector.model import Detector
from upvl_cli.types import Boxes


def state() -> TrainState:
    return TrainState(
        step=4,
        model={"a.b": torch.arange(3.0)},
        moments={"exp_avg/a.b": torch.ones(3), "step/a.b": torch.tensor(4.0)},
        best={"a.b": torch.zeros(3)},
        lowest_loss=0.1,
        curve=[[0.1, 6, 1, 2, 3, 0.0]] * 4,
        checks=[[4, 0.1]],
        pseudo_labels={
            7: Boxes.from_rows(np.arange(14.0).reshape(2, 7)),
            2: Boxes.from_rows(np.ones((1, 7))),
        },
    )


def test_all_of_it_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "c.safetensors"
    save_checkpoint(path, state(), "mine")
    again = load_checkpoint(path, "mine")
    assert again is not None
    assert (again.step, again.lowest_loss, again.curve, again.checks) == (
        4,
        0.1,
        state().curve,
        state().checks,
    )
    for part in ("model", "moments", "best"):
        assert {n: t.tolist() for n, t in getattr(again, part).items()} == {
            n: t.tolist() for n, t in getattr(state(), part).items()
        }
    assert {n: b.to_rows().tolist() for n, b in again.pseudo_labels.items()} == {
        n: b.to_rows().tolist() for n, b in state().pseudo_labels.items()
    }


def test_an_empty_one_too(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "c", TrainState(), "mine")
    assert load_checkpoint(tmp_path / "c", "mine") == TrainState()


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-10], lambda b: b"", lambda b: b"x" * len(b), lambda b: b[:8]]
)
def test_what_is_not_whole_or_not_mine_is_passed_over(tmp_path: Path, damage) -> None:  # noqa: ANN001
    path = tmp_path / "c"
    assert load_checkpoint(path, "mine") is None
    save_checkpoint(path, state(), "mine")
    assert load_checkpoint(path, "other") is None
    path.write_bytes(damage(path.read_bytes()))
    assert load_checkpoint(path, "mine") is None


def test_a_network_comes_back_from_its_bytes() -> None:
    detector = Detector(small_config("centers"), True)
    config = unpack_config(pack_config(detector.config))
    assert config == small_config("centers")
    again = unpack_detector(pack_weights(detector.state_dict()), config, True)
    assert not again.training
    assert all(torch.equal(a, b) for a, b in zip(detector.parameters(), again.parameters(), strict=True))
    with pytest.raises(RuntimeError):
        unpack_detector(pack_weights(detector.state_dict()), small_config("anchors"), False)
