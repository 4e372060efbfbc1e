"""Training by the step: it learns, the same each time, alone or in company, and after a stop."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import SMALL, street

from upvl_cli.detector.batch import Sample
from upvl_cli.detector.checkpoint import State, keep, packed, resume
from upvl_cli.detector.loss import Space
from upvl_cli.detector.model import Detector
from upvl_cli.detector.sampler import item
from upvl_cli.detector.together import Team
from upvl_cli.detector.training import Lesson, Plan, learn

PLAN = Plan(steps=6, batch=2, rate=0.01, distil=1.0, check_steps=2, rounds=1, trust=0.0, seed=3, half=False)
ALONE = Team(0, 1, torch.device("cpu"))


class Streets:
    """Frames without a file: three to learn from, one held out (`training.Frames`)."""

    train, held_out = 3, 1

    def __init__(self) -> None:
        self.found: list[int] = []

    def plain(self, number: int) -> Sample:
        return street(number)

    def changed(self, at: int, found: Mapping[int, np.ndarray]) -> Sample:
        number = item(at, self.train, PLAN.seed)
        self.found += [number] * (number in found)
        return street(number)


def lesson(plan: Plan = PLAN, team: Team = ALONE) -> Lesson:
    torch.manual_seed(plan.seed)
    space = Space.of(np.full(70, 0.1, np.float32), np.eye(64, 70, dtype=np.float32))
    return Lesson(Detector(SMALL, 8, "anchors", True), Streets(), space, plan, team)


def nothing(*_: object) -> None:
    """Nobody watches."""


@pytest.fixture(scope="module")
def undisturbed() -> State:
    return learn(lesson(), State(), keep=nothing, tick=nothing)


def test_the_loss_falls_and_the_rate_rises_and_falls(undisturbed: State) -> None:
    rate, total = np.array(undisturbed.curve)[:, :2].T
    assert len(rate) == undisturbed.step == 6
    assert total[-1] < 0.7 * total[0]
    assert rate[0] == pytest.approx(0.01) and (np.diff(rate[1:]) < 0).all()
    np.testing.assert_allclose(
        np.array(undisturbed.curve)[:, 1], np.array(undisturbed.curve)[:, 2:].sum(axis=1), rtol=1e-5
    )
    steps, checks = np.array(undisturbed.checks).T
    assert steps.tolist() == [2, 4, 6]
    assert undisturbed.lowest == checks.min()


@pytest.mark.parametrize("stop", [1, 3, 5, 6])
def test_a_stopped_run_goes_on_to_the_same_bytes(undisturbed: State, tmp_path: Path, stop: int) -> None:
    path = tmp_path / "checkpoint.safetensors"
    left = [stop]

    def stopping() -> None:
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(lesson(), State(), keep=lambda state: keep(path, state, "s"), tick=stopping)
    begun = resume(path, "s")
    assert (begun.step if begun else 0) == stop // 2 * 2
    torch.manual_seed(99)  # no hidden state counts
    again = learn(lesson(), begun or State(), keep=nothing, tick=nothing)
    np.testing.assert_array_equal(packed(again.best), packed(undisturbed.best))
    assert again.curve == undisturbed.curve
    assert again.checks == undisturbed.checks


def test_a_second_round_learns_from_what_the_first_found() -> None:
    one = lesson(Plan(**{**vars(PLAN), "rounds": 2, "steps": 2}))
    state = learn(one, State(), keep=nothing, tick=nothing)
    assert state.step == 4
    assert one.frames.found  # trust 0: something is found in each frame
    assert {boxes.shape[1] for boxes in state.found.values()} == {7}
    first = learn(lesson(Plan(**{**vars(PLAN), "steps": 2})), State(), keep=nothing, tick=nothing)
    assert state.curve[0] == first.curve[0]


def test_each_frame_comes_once_a_turn_in_an_order_of_the_seed() -> None:
    def turn(number: int, seed: int) -> list[int]:
        return [item(at, 10, seed) for at in range(10 * number, 10 * number + 10)]

    assert sorted(turn(0, 1)) == list(range(10))
    assert turn(1, 1) == turn(1, 1)
    assert turn(0, 1) != turn(0, 2)
    assert turn(0, 1) != turn(1, 1)


TOGETHER = """
import sys, json
sys.path[:0] = {paths}
from test_training import PLAN, State, learn, lesson, nothing, packed
from upvl_cli.detector.together import team
with team() as here:
    assert here.size == 2
    state = learn(lesson(PLAN, here), State(), keep=nothing, tick=nothing)
    if here.rank == 0:
        open({out!r}, "w").write(json.dumps([state.curve, state.checks]))
"""


def test_two_processes_learn_as_one(undisturbed: State, tmp_path: Path) -> None:
    import json

    here = Path(__file__).parent
    script, out = tmp_path / "together.py", tmp_path / "curve.json"
    script.write_text(TOGETHER.format(paths=[str(here), str(here.parent)], out=str(out)))
    command = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--standalone",
        "--nproc-per-node",
        "2",
        str(script),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    curve, checks = json.loads(out.read_text())
    np.testing.assert_allclose(curve, undisturbed.curve, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(checks, undisturbed.checks, rtol=1e-5)
