"""Training in several processes: the frames of a step are the same for any number of them, also after a stop."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_training import ALONE, CONFIG, Streets, nothing, setup_of

from upvl_cli.detector.checkpoint import TrainState, load_checkpoint, pack_checkpoint, unpack_checkpoint
from upvl_cli.detector.process_group import ProcessGroup
from upvl_cli.detector.train import train

# Small steps: two halves of a batch are rounded otherwise than the whole, and each step of AdamW multiplies that.
GENTLE = replace(CONFIG, optimizer=replace(CONFIG.optimizer, learning_rate=1e-4))
UNEVEN = replace(GENTLE, batch=3)

RUN = """
import json, os, signal, sys
sys.path[:0] = {paths}
from test_processes import GENTLE, UNEVEN, Recorder, begun, nothing, setup_of, train
from upvl_cli.detector.checkpoint import save_checkpoint
from upvl_cli.detector.process_group import process_group
from dataclasses import replace
config, stop, checkpoint, out = {config}, {stop}, {checkpoint!r}, {out!r}
with process_group() as group:
    frames = Recorder(out + f"/frames-{name}-{{group.rank}}.txt")
    steps = [0]
    def tick():
        steps[0] += 1
        if steps[0] == stop:
            os.kill(os.getpid(), signal.SIGKILL)
    def save(state):
        if group.rank == 0:
            save_checkpoint(__import__("pathlib").Path(checkpoint), state, "s")
    setup = replace(setup_of(config, group), frames=frames)
    state = train(setup, begun(group, checkpoint), save=save, tick=tick)
    if group.rank == 0:
        open(out + "/{name}.json", "w").write(json.dumps([state.curve, state.checks]))
"""


class Recorder(Streets):
    """Streets that write down which frames are drawn, line by line: a killed process leaves what it drew."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self._path = path

    def augmented(self, index: int, pseudo_labels: Any) -> Any:
        with open(self._path, "a") as file:
            file.write(f"{index} {self.number_at(index)}\n")
        return super().augmented(index, pseudo_labels)


def begun(group: ProcessGroup, checkpoint: str) -> TrainState:
    """The state of a checkpoint that the first process reads for all, as the stage does it."""
    state = load_checkpoint(Path(checkpoint), "s") if group.rank == 0 else None
    packed = group.broadcast(pack_checkpoint(state or TrainState(), ""))
    return state or unpack_checkpoint(packed, "") or TrainState()


def run(folder: Path, name: str, processes: int, config: str = "GENTLE", stop: int = -1) -> int:
    """Train by torchrun in some processes, from the checkpoint of the folder on; the exit code."""
    here = Path(__file__).parent
    script = folder / f"{name}.py"
    script.write_text(
        RUN.format(
            paths=[str(here), str(here.parent)], config=config, stop=stop, name=name, out=str(folder),
            checkpoint=str(folder / "checkpoint.safetensors"),
        )
    )  # fmt: skip
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    done = subprocess.run(
        [*command, str(processes), str(script)], capture_output=True, text=True, timeout=300
    )
    return done.returncode


def drawn(folder: Path, name: str) -> dict[int, int]:
    """The number of the frame at each index that any process drew."""
    lines = [line for path in folder.glob(f"frames-{name}-*.txt") for line in path.read_text().splitlines()]
    return {int(index): int(number) for index, number in (line.split() for line in lines)}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrainState, dict[int, int]]:
    folder = tmp_path_factory.mktemp("alone")
    setup = replace(setup_of(GENTLE, ALONE), frames=Recorder(str(folder / "frames-alone-0.txt")))
    return train(setup, TrainState(), save=nothing, tick=nothing), drawn(folder, "alone")


@pytest.mark.slow
def test_two_processes_killed_and_one_that_goes_on(
    alone: tuple[TrainState, dict[int, int]], tmp_path: Path
) -> None:
    expected, frames = alone
    assert run(tmp_path, "two", 2, stop=3) != 0  # after the checkpoint of step 2
    assert not (tmp_path / "two.json").exists()
    state = load_checkpoint(tmp_path / "checkpoint.safetensors", "s")
    assert state is not None and state.step == 2
    assert run(tmp_path, "one", 1) == 0
    curve, checks = json.loads((tmp_path / "one.json").read_text())
    two, one = drawn(tmp_path, "two"), drawn(tmp_path, "one")
    assert set(range(6)) <= set(two) and set(one) == set(range(4, 12))  # two frames a step, from step 2 on
    assert two.items() <= frames.items() and one.items() <= frames.items()
    np.testing.assert_allclose(curve, expected.curve, rtol=1e-4)
    np.testing.assert_allclose(checks, expected.checks, rtol=1e-4)


@pytest.mark.slow
def test_one_process_killed_and_two_that_go_on_with_uneven_shares(tmp_path: Path) -> None:
    expected = train(setup_of(UNEVEN, ALONE), TrainState(), save=nothing, tick=nothing)
    assert run(tmp_path, "one", 1, "UNEVEN", stop=3) != 0
    assert run(tmp_path, "two", 2, "UNEVEN") == 0
    curve, checks = json.loads((tmp_path / "two.json").read_text())
    assert set(drawn(tmp_path, "two")) == set(range(6, 18))
    np.testing.assert_allclose(curve, expected.curve, rtol=1e-4)
    np.testing.assert_allclose(checks, expected.checks, rtol=1e-4)


@pytest.mark.slow
def test_two_processes_find_the_pseudo_labels_of_one(tmp_path: Path) -> None:
    rounds = "replace(GENTLE, steps=2, self_training=replace(GENTLE.self_training, rounds=2))"
    config = replace(GENTLE, steps=2, self_training=replace(GENTLE.self_training, rounds=2))
    expected = train(setup_of(config, ALONE), TrainState(), save=nothing, tick=nothing)
    assert expected.pseudo_labels
    assert run(tmp_path, "two", 2, rounds) == 0
    state = load_checkpoint(tmp_path / "checkpoint.safetensors", "s")
    assert state is not None
    assert {n: len(b) for n, b in state.pseudo_labels.items()} == {
        n: len(b) for n, b in expected.pseudo_labels.items()
    }
    for number, boxes in expected.pseudo_labels.items():
        np.testing.assert_allclose(state.pseudo_labels[number].to_rows(), boxes.to_rows(), atol=1e-2)


@pytest.mark.parametrize(("total", "size"), [(12, 1), (12, 5), (3, 3), (128, 7)])
def test_shares_are_disjoint_and_nearly_equal(total: int, size: int) -> None:
    shares = [ProcessGroup(rank, size, ALONE.device).share(total) for rank in range(size)]
    assert [place for share in shares for place in share] == list(range(total))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
