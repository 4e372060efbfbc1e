"""Training of the detector: steps of AdamW over a seeded order of frames; a stopped run goes on bit for bit.

No random number has a hidden state: each follows from the seed and the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from upvl_cli.detector.checkpoint import LOSSES, TrainState, boxes_by_frame, rows_of_frames
from upvl_cli.detector.config import TrainConfig
from upvl_cli.detector.data.batch import Batch, Sample, collate, concat_batches
from upvl_cli.detector.decode import decode_output
from upvl_cli.detector.loss import Criterion, FeatureSpace, Losses, losses
from upvl_cli.detector.model import Detector
from upvl_cli.detector.process_group import ProcessGroup, half_precision
from upvl_cli.detector.targets import Targets, concat_targets, make_targets
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Boxes


class Frames(Protocol):
    """The frames to train on, and those held out."""

    @property
    def train(self) -> int:
        """How many to train on."""

    @property
    def held_out(self) -> int:
        """How many are held out for the checks."""

    def number_at(self, index: int) -> int:
        """Return the number of the frame at an index of the order."""

    def augmented(self, index: int, pseudo_labels: dict[int, Boxes]) -> Sample:
        """Return the frame at an index of the order, randomly changed; `pseudo_labels` are more boxes of some."""

    def unchanged(self, number: int) -> Sample:
        """Return a frame as it is; the held-out ones follow on those to train on."""


@dataclass(frozen=True)
class TrainSetup:
    """What is trained on what, and where.

    Attributes:
        detector: The network; its weights are those of the state.
        frames: Training and held-out frames.
        space: Where features are compared.
        config: Settings.
        group: Where it computes.
    """

    detector: Detector
    frames: Frames
    space: FeatureSpace
    config: TrainConfig
    group: ProcessGroup


def train(
    setup: TrainSetup,
    state: TrainState,
    *,
    save: Callable[[TrainState], None],
    tick: Callable[[], None],
) -> TrainState:
    """Train from where `state` is to the end; the weights of the lowest held-out loss are in its `best`.

    Args:
        setup: What is trained on what.
        state: An empty one with the weights to begin with, or that of a checkpoint.
        save: Called at each check on the held-out frames, with all that is needed to go on from there.
        tick: Called after each step.
    """
    config, group = setup.config, setup.group
    initial = {name: tensor.clone() for name, tensor in setup.detector.state_dict().items()}
    setup.detector.to(group.device)
    with _deterministic(group.device):
        for number in range(state.step // config.steps, config.self_training.rounds):
            if state.step == number * config.steps:
                state = _begin_round(setup, state, initial)
            _run_round(setup, state, save, tick)
    return state


def _begin_round(setup: TrainSetup, state: TrainState, initial: dict[str, Tensor]) -> TrainState:
    """Return the state at the start of a round: initial weights, and detections of the best of the round before."""
    pseudo_labels: dict[int, Boxes] = {}
    if state.step:
        setup.detector.load_state_dict(state.best)
        pseudo_labels = _pseudo_labels(setup, range(state.step, state.step + setup.config.steps))
    return TrainState(
        state.step, initial, curve=state.curve, checks=state.checks, pseudo_labels=pseudo_labels
    )


def _run_round(
    setup: TrainSetup,
    state: TrainState,
    save: Callable[[TrainState], None],
    tick: Callable[[], None],
) -> None:
    """Take the steps of a round that are left."""
    config, detector = setup.config, setup.detector
    detector.load_state_dict(state.model)
    optimizer = torch.optim.AdamW(detector.parameters(), weight_decay=config.optimizer.weight_decay)
    _restore_moments(optimizer, detector, state.moments)
    end = (state.step // config.steps + 1) * config.steps
    steps = range(state.step, end)
    for step, frames in zip(steps, _frames_of_steps(setup, steps, state.pseudo_labels), strict=True):
        learning_rate = learning_rate_at(step % config.steps, config)
        mean_losses = _step(setup, optimizer, frames, learning_rate)
        state.curve.append([learning_rate, *mean_losses])
        state.step = step + 1
        if state.step == end or state.step % config.check_steps == 0:
            _check(setup, state)
            state.model = _weights_of(detector)
            state.moments = _moments_of(optimizer, detector)
            save(state)
        tick()


def _frames_of_steps(
    setup: TrainSetup, steps: range, pseudo_labels: dict[int, Boxes]
) -> Iterator[list[tuple[Batch, Targets]]]:
    """Yield this process's frames of each step, made ahead by threads.

    The frames of a step follow from the seed and the step alone; the processes share them.
    """
    batch, share = setup.config.batch, setup.group.share(setup.config.batch)
    indices = (step * batch + place for step in steps for place in share)
    frames = in_order(
        lambda index: _with_targets(setup, setup.frames.augmented(index, pseudo_labels)), indices
    )
    for _ in steps:
        yield [next(frames) for _ in share]


def _with_targets(setup: TrainSetup, sample: Sample) -> tuple[Batch, Targets]:
    batch = collate([sample], setup.detector.grid)
    return batch, make_targets(setup.detector.head, batch.boxes)


def _step(
    setup: TrainSetup,
    optimizer: torch.optim.Optimizer,
    frames: list[tuple[Batch, Targets]],
    learning_rate: float,
) -> list[float]:
    """Take one step of the optimizer and return the losses in the order of `LOSSES`, means over all processes."""
    for group in optimizer.param_groups:
        group["lr"] = learning_rate
    optimizer.zero_grad()
    of_batch = _losses_of(setup, frames)
    # A loss is a mean over frames: where processes have unequal numbers of frames, their means count accordingly.
    share = len(frames) * setup.group.size / setup.config.batch
    (of_batch.total * share).backward()  # type: ignore[no-untyped-call]
    weights = list(setup.detector.parameters())
    for weight in weights:
        if weight.grad is None:  # nothing in this batch reaches it: another process may differ
            weight.grad = torch.zeros_like(weight)
    mean_losses = torch.stack([getattr(of_batch, name).detach().float() * share for name in LOSSES])
    setup.group.average([mean_losses, *(weight.grad for weight in weights if weight.grad is not None)])
    clip_grad_norm_(weights, setup.config.optimizer.max_gradient_norm)
    optimizer.step()
    return [float(value) for value in mean_losses]


def _losses_of(setup: TrainSetup, frames: list[tuple[Batch, Targets]]) -> Losses:
    detector, device, config = setup.detector, setup.group.device, setup.config
    batch = concat_batches([batch for batch, _ in frames]).to(device)
    targets = concat_targets([targets for _, targets in frames]).to(device)
    with half_precision(device, enabled=config.precision == "half"):
        output = detector(batch)
    criterion = Criterion(setup.space.to(device), config.loss, config.distillation)
    return losses(detector, output, batch, targets, criterion)


def _check(setup: TrainSetup, state: TrainState) -> None:
    """Compute the loss on the held-out frames (no human label is read) and keep the weights if it is the lowest."""
    frames, group = setup.frames, setup.group
    held_out = range(frames.train, frames.train + frames.held_out)
    total = torch.zeros((), dtype=torch.float64, device=group.device)
    setup.detector.train(False)
    with torch.no_grad():
        for frame in in_order(
            lambda number: _with_targets(setup, frames.unchanged(number)), held_out[group.rank :: group.size]
        ):
            total += _losses_of(setup, [frame]).total
    setup.detector.train()
    group.average([total])
    loss = float(total) * group.size / max(len(held_out), 1)
    if held_out:
        state.checks.append([state.step, loss])
    if loss < state.lowest_loss or not held_out:
        state.lowest_loss, state.best = loss, _weights_of(setup.detector)


def _pseudo_labels(setup: TrainSetup, steps: range) -> dict[int, Boxes]:
    """Return the detections that overlap no label of their frame, by number, of all frames that some steps draw."""
    batch, group = setup.config.batch, setup.group
    drawn = {setup.frames.number_at(index) for index in range(steps.start * batch, steps.stop * batch)}
    numbers = sorted(drawn)[group.rank :: group.size]
    return boxes_by_frame(group.concat(rows_of_frames(dict(_detections(setup, numbers)))))


def _detections(setup: TrainSetup, numbers: Sequence[int]) -> Iterator[tuple[int, Boxes]]:
    """Yield the number of each frame with detections that overlap none of its labels, and these."""
    detector, device, config = setup.detector.train(False), setup.group.device, setup.config
    with torch.no_grad():
        for number, sample in zip(numbers, in_order(setup.frames.unchanged, numbers), strict=True):
            batch = collate([sample], detector.grid).to(device)
            with half_precision(device, enabled=config.precision == "half"):
                output = detector(batch)
            (boxes,) = decode_output(detector, output, config.self_training.pseudo_label)
            new = ~(iou_bev(boxes, sample.boxes) > 0).any(axis=1)
            if new.any():
                yield number, Boxes(boxes.center_m[new], boxes.size_lwh_m[new], boxes.heading_rad[new])
    detector.train()


def learning_rate_at(step: int, config: TrainConfig) -> float:
    """Return the learning rate of a step of a round: a linear rise, then half a cosine (SGDR, ICLR 2017).

    Args:
        step: Steps of the round before this one.
        config: Number of steps, highest rate and share of the rise.
    """
    highest = config.optimizer.learning_rate
    warm_up = max(round(config.optimizer.warm_up_share * config.steps), 1)
    if step < warm_up:
        return highest * (step + 1) / warm_up
    return highest * (1 + math.cos(math.pi * (step - warm_up) / max(config.steps - warm_up, 1))) / 2


def _weights_of(detector: Detector) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().clone() for name, tensor in detector.state_dict().items()}


def _moments_of(optimizer: torch.optim.Optimizer, detector: Detector) -> dict[str, Tensor]:
    """Return the state of the optimizer for each weight, by name."""
    return {
        f"{kind}/{name}": tensor.detach().cpu().clone()
        for name, weight in detector.named_parameters()
        for kind, tensor in optimizer.state[weight].items()
    }


def _restore_moments(
    optimizer: torch.optim.Optimizer, detector: Detector, moments: dict[str, Tensor]
) -> None:
    names = [name for name, _ in detector.named_parameters()]
    kinds = {key.partition("/")[0] for key in moments}
    held = {
        number: {kind: moments[f"{kind}/{name}"].clone() for kind in kinds}
        for number, name in enumerate(names)
    }
    if moments:
        optimizer.load_state_dict({**optimizer.state_dict(), "state": held})


@contextmanager
def _deterministic(device: torch.device) -> Iterator[None]:
    """Make the same steps give the same bits on a processor."""
    # Filling new memory would cost a tenth of a step: nothing here reads what it has not written.
    filling = torch.utils.deterministic
    before = torch.are_deterministic_algorithms_enabled(), filling.fill_uninitialized_memory  # type: ignore[attr-defined]
    torch.use_deterministic_algorithms(device.type == "cpu")
    filling.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0])
        filling.fill_uninitialized_memory = before[1]  # type: ignore[attr-defined]
