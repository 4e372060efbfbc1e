"""Training by the step: it learns, the same each time, alone or in company, and after a stop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import SHIPPED, small_config, street

from upvl_cli.detector.checkpoint import TrainState, load_checkpoint, pack_weights, save_checkpoint
from upvl_cli.detector.config import TrainConfig
from upvl_cli.detector.data.batch import Sample
from upvl_cli.detector.data.sampler import FrameOrder
from upvl_cli.detector.loss import FeatureSpace
from upvl_cli.detector.model import Detector
from upvl_cli.detector.process_group import ProcessGroup, half_precision
from upvl_cli.detector.train import TrainSetup, learning_rate_at, train
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.types import Boxes

CONFIG = replace(
    SHIPPED,
    steps=6,
    batch=2,
    check_steps=2,
    seed=3,
    precision="full",
    optimizer=replace(SHIPPED.optimizer, learning_rate=0.01),
    self_training=replace(
        SHIPPED.self_training, pseudo_label=replace(SHIPPED.self_training.pseudo_label, min_score=0.0)
    ),
)
ALONE = ProcessGroup(0, 1, torch.device("cpu"))


class Streets:
    """Frames without a file: three to train on, one held out (`train.Frames`)."""

    train, held_out = 3, 1

    def __init__(self) -> None:
        self.pseudo_labelled: list[int] = []

    def unchanged(self, number: int) -> Sample:
        return street(number)

    def number_at(self, index: int) -> int:
        return FrameOrder(self.train, CONFIG.seed, CONFIG.shuffle).frame_at(index)

    def augmented(self, index: int, pseudo_labels: Mapping[int, Boxes]) -> Sample:
        number = self.number_at(index)
        self.pseudo_labelled += [number] * (number in pseudo_labels)
        return street(number)


def setup_of(config: TrainConfig = CONFIG, group: ProcessGroup = ALONE) -> TrainSetup:
    torch.manual_seed(config.seed)
    space = FeatureSpace.from_basis(np.full(70, 0.1, np.float32), np.eye(64, 70, dtype=np.float32))
    return TrainSetup(Detector(small_config(), True), Streets(), space, config, group)


def nothing(*_: object) -> None:
    """Nobody watches."""


@pytest.fixture(scope="module")
def undisturbed() -> TrainState:
    return train(setup_of(), TrainState(), save=nothing, tick=nothing)


def test_the_loss_falls_and_the_rate_rises_and_falls(undisturbed: TrainState) -> None:
    rate, total = np.array(undisturbed.curve)[:, :2].T
    assert len(rate) == undisturbed.step == 6
    assert total[-1] < 0.7 * total[0]
    assert rate[0] == pytest.approx(0.01) and (np.diff(rate[1:]) < 0).all()
    np.testing.assert_allclose(
        np.array(undisturbed.curve)[:, 1], np.array(undisturbed.curve)[:, 2:].sum(axis=1), rtol=1e-5
    )
    steps, checks = np.array(undisturbed.checks).T
    assert steps.tolist() == [2, 4, 6]
    assert undisturbed.lowest_loss == checks.min()


@pytest.mark.parametrize("stop", [1, 3, 5, 6])
def test_a_stopped_run_goes_on_to_the_same_bytes(undisturbed: TrainState, tmp_path: Path, stop: int) -> None:
    path = tmp_path / "checkpoint.safetensors"
    left = [stop]

    def stopping() -> None:
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(setup_of(), TrainState(), save=lambda state: save_checkpoint(path, state, "s"), tick=stopping)
    begun = load_checkpoint(path, "s")
    assert (begun.step if begun else 0) == stop // 2 * 2
    torch.manual_seed(99)  # no hidden state counts
    again = train(setup_of(), begun or TrainState(), save=nothing, tick=nothing)
    np.testing.assert_array_equal(pack_weights(again.best), pack_weights(undisturbed.best))
    assert again.curve == undisturbed.curve
    assert again.checks == undisturbed.checks


def test_a_second_round_learns_from_what_the_first_found() -> None:
    self_training = replace(CONFIG.self_training, rounds=2)
    one = setup_of(replace(CONFIG, steps=2, self_training=self_training))
    state = train(one, TrainState(), save=nothing, tick=nothing)
    assert state.step == 4
    assert one.frames.pseudo_labelled  # with a score of 0 something is found in each frame
    assert all(len(boxes) for boxes in state.pseudo_labels.values())
    first = train(setup_of(replace(CONFIG, steps=2)), TrainState(), save=nothing, tick=nothing)
    assert state.curve[0] == first.curve[0]


@pytest.mark.parametrize(
    ("step", "expected"),
    [(0, 0.5), (1, 1.0), (2, 1.0), (21, 0.5), (39, (1 + np.cos(np.pi * 37 / 38)) / 2)],
)
def test_the_learning_rate_rises_in_a_line_and_falls_in_half_a_cosine(step: int, expected: float) -> None:
    config = replace(
        CONFIG, steps=40, optimizer=replace(CONFIG.optimizer, learning_rate=0.2, warm_up_share=0.05)
    )
    assert learning_rate_at(step, config) == pytest.approx(0.2 * expected)


def test_half_precision_is_asked_of_devices_that_have_it() -> None:
    device = torch.device("cpu")
    assert not half_precision(device, enabled=False)._enabled
    has_units = torch.cpu.get_capabilities().get("amx_bf16", False)
    assert half_precision(device, enabled=True)._enabled == has_units


class Fewer(Streets):
    """One frame to train on, none held out."""

    train, held_out = 1, 0


def checks_of(config: TrainConfig, frames: Streets) -> tuple[TrainState, list[np.ndarray]]:
    """The end of a training, and the weights at each check."""
    setup = replace(setup_of(config), frames=frames)
    weights: list[np.ndarray] = []
    state = train(setup, TrainState(), save=lambda s: weights.append(pack_weights(s.model)), tick=nothing)
    return state, weights


def test_the_best_weights_change_only_when_the_held_out_loss_is_lower() -> None:
    # A learning rate that is too high by far at the third step.
    wild = replace(CONFIG.optimizer, learning_rate=0.3, warm_up_share=0.99)
    state, weights = checks_of(replace(CONFIG, steps=3, batch=1, check_steps=1, optimizer=wild), Streets())
    losses = [loss for _, loss in state.checks]
    lowest = int(np.argmin(losses))
    assert lowest < len(losses) - 1, losses
    np.testing.assert_array_equal(pack_weights(state.best), weights[lowest])
    assert state.lowest_loss == losses[lowest]


def test_without_held_out_frames_the_last_weights_are_the_best() -> None:
    state, weights = checks_of(replace(CONFIG, steps=3, batch=1), Fewer())
    assert state.checks == []
    np.testing.assert_array_equal(pack_weights(state.best), weights[-1])
    assert len(weights) == 2  # at step 2 and at the end


def test_pseudo_labels_overlap_no_label() -> None:
    self_training = replace(CONFIG.self_training, rounds=2)
    state, _ = checks_of(replace(CONFIG, steps=1, batch=1, self_training=self_training), Fewer())
    assert len(state.pseudo_labels[0]) > 3
    assert (iou_bev(state.pseudo_labels[0], street(0).boxes) == 0).all()


def test_a_gradient_is_cut_and_weights_decay_as_the_settings_say() -> None:
    def change(**values: float) -> float:
        config = replace(CONFIG, steps=1, batch=1, optimizer=replace(CONFIG.optimizer, **values))
        setup = replace(setup_of(config), frames=Fewer())
        before = setup.detector.backbone.mix.conv.weight.detach().clone()
        train(setup, TrainState(), save=nothing, tick=nothing)
        after = setup.detector.backbone.mix.conv.weight.detach()
        return float((after - before).norm())

    whole = change()
    assert change(max_gradient_norm=1e-9) < 0.5 * whole  # AdamW's epsilon then outweighs the gradient
    assert change(weight_decay=1.0) != whole
