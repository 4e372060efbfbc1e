"""How the detector learns: steps of AdamW over a seeded order of frames, going on after a stop as if there was none.

No random number has a hidden state: each follows from the seed and the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from upvl_cli.detector import targets
from upvl_cli.detector.batch import Batch, Sample, collate, joined
from upvl_cli.detector.checkpoint import LOSSES, State
from upvl_cli.detector.decode import detections
from upvl_cli.detector.loss import Losses, Space, losses
from upvl_cli.detector.model import Detector
from upvl_cli.detector.together import Team, half_precision
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Array

Exercise = tuple[Batch, targets.Targets]  # one frame and what has to be said of it
_WARM_UP = 0.05  # share of the steps in which the rate rises, so that the moments of AdamW are known first
_DECAY = 0.01  # AdamW (Loshchilov and Hutter, ICLR 2019)
_LONGEST_GRADIENT = 10.0  # as in PointPillars of OpenPCDet


@dataclass(frozen=True)
class Plan:
    """The numbers of a training.

    Attributes:
        steps: How many in a round.
        batch: Frames of each, over all processes.
        rate: Highest learning rate.
        distil: Weight of the features in the loss.
        check_steps: Between two looks at the held-out frames.
        rounds: Trainings one after the other; each but the first learns also from what the one before found.
        trust: Least score of what is found.
        seed: Of the weights, the order and all chance.
        half: Whether to compute in bfloat16 where that is quicker.
    """

    steps: int
    batch: int
    rate: float
    distil: float
    check_steps: int
    rounds: int
    trust: float
    seed: int
    half: bool


class Frames(Protocol):
    """The frames to learn from, and those held out."""

    @property
    def train(self) -> int:
        """How many to learn from."""

    @property
    def held_out(self) -> int:
        """How many are held out."""

    def changed(self, at: int, found: dict[int, Array]) -> Sample:
        """That at a place of the order of those to learn from, with chance; `found` has more boxes of some."""

    def plain(self, number: int) -> Sample:
        """One of them as it is; the held-out ones follow on those to learn from."""


@dataclass(frozen=True)
class Lesson:
    """What learns from what, and where.

    Attributes:
        detector: The network; its weights are those of the state.
        frames: What it learns from.
        space: Where features are compared.
        plan: The numbers.
        team: Where it computes.
    """

    detector: Detector
    frames: Frames
    space: Space
    plan: Plan
    team: Team


def learn(lesson: Lesson, state: State, *, keep: Callable[[State], None], tick: Callable[[], None]) -> State:
    """Train from where `state` is to the end; the weights that are worth keeping are in its `best`.

    Args:
        lesson: What learns from what.
        state: An empty one with the weights to begin with, or that of a checkpoint.
        keep: Called at each look at the held-out frames, with all that is needed to go on from there.
        tick: Called after each step.
    """
    plan, team = lesson.plan, lesson.team
    first = {name: tensor.clone() for name, tensor in lesson.detector.state_dict().items()}
    lesson.detector.to(team.device)
    with _repeatable(team.device):
        for number in range(state.step // plan.steps, plan.rounds):
            if state.step == number * plan.steps:
                state = _begun(lesson, state, first)
            _round(lesson, state, keep, tick)
    return state


def _begun(lesson: Lesson, state: State, first: dict[str, Tensor]) -> State:
    """The state at the start of a round: new weights, and what the best of the round before find."""
    found = {}
    if state.step:
        lesson.detector.load_state_dict(state.best)
        found = dict(_found(lesson))
    return State(state.step, first, curve=state.curve, checks=state.checks, found=found)


def _round(lesson: Lesson, state: State, keep: Callable[[State], None], tick: Callable[[], None]) -> None:
    """Take the steps of a round that are left."""
    plan, detector = lesson.plan, lesson.detector
    detector.load_state_dict(state.model)
    optimizer = torch.optim.AdamW(detector.parameters(), weight_decay=_DECAY)
    _remember(optimizer, detector, state.moments)
    last = (state.step // plan.steps + 1) * plan.steps
    steps = range(state.step, last)
    for step, batch in zip(steps, _batches(lesson, steps, state.found), strict=True):
        rate = _rate(step % plan.steps, plan)
        said = _step(lesson, optimizer, batch, rate)
        state.curve.append([rate, *said])
        state.step = step + 1
        if state.step == last or state.step % plan.check_steps == 0:
            _check(lesson, state)
            state.model = _copied(detector)
            state.moments = _moments(optimizer, detector)
            keep(state)
        tick()


def _batches(lesson: Lesson, steps: range, found: dict[int, Array]) -> Iterator[list[Exercise]]:
    """This process's part of each step, made ahead by threads."""
    plan, team = lesson.plan, lesson.team
    each = plan.batch // team.size
    first = (step * plan.batch + team.rank * each for step in steps)
    places = (start + place for start in first for place in range(each))
    made = in_order(lambda at: _exercise(lesson, lesson.frames.changed(at, found)), places)
    for _ in steps:
        yield [next(made) for _ in range(each)]


def _exercise(lesson: Lesson, sample: Sample) -> Exercise:
    batch = collate([sample], lesson.detector.grid)
    return batch, targets.targets(lesson.detector.head, batch.boxes)


def _step(
    lesson: Lesson, optimizer: torch.optim.Optimizer, exercises: list[Exercise], rate: float
) -> list[float]:
    """Go down the gradient once; returns the losses in the order of `LOSSES`."""
    for group in optimizer.param_groups:
        group["lr"] = rate
    optimizer.zero_grad()
    found = _losses(lesson, exercises)
    found.total.backward()  # type: ignore[no-untyped-call]
    weights = list(lesson.detector.parameters())
    for weight in weights:
        if weight.grad is None:  # nothing in this batch reaches it: another process may differ
            weight.grad = torch.zeros_like(weight)
    told = torch.stack([getattr(found, name).detach().float() for name in LOSSES])
    lesson.team.mean([told, *(weight.grad for weight in weights if weight.grad is not None)])
    clip_grad_norm_(weights, _LONGEST_GRADIENT)
    optimizer.step()
    return [float(value) for value in told]


def _losses(lesson: Lesson, exercises: list[Exercise]) -> Losses:
    detector, device = lesson.detector, lesson.team.device
    batch = joined([batch for batch, _ in exercises]).to(device)
    wanted = targets.joined([wanted for _, wanted in exercises]).to(device)
    with half_precision(device, wanted=lesson.plan.half):
        output = detector(batch)
    return losses(detector, output, batch, wanted, lesson.space.to(device), distil=lesson.plan.distil)


def _check(lesson: Lesson, state: State) -> None:
    """Look at the held-out frames, without any label of a person; the weights are kept where they are better."""
    frames, team = lesson.frames, lesson.team
    held_out = range(frames.train, frames.train + frames.held_out)
    loss = torch.zeros((), dtype=torch.float64, device=team.device)
    lesson.detector.train(False)
    with torch.no_grad():
        for exercise in in_order(
            lambda number: _exercise(lesson, frames.plain(number)), held_out[team.rank :: team.size]
        ):
            loss += _losses(lesson, [exercise]).total
    lesson.detector.train()
    team.mean([loss])
    found = float(loss) * team.size / max(len(held_out), 1)
    if held_out:
        state.checks.append([state.step, found])
    if found < state.lowest or not held_out:
        state.lowest, state.best = found, _copied(lesson.detector)


def _found(lesson: Lesson) -> Iterator[tuple[int, Array]]:
    """What the network is sure of in the frames to learn from: boxes on no label, by number of the frame."""
    detector, device = lesson.detector.train(False), lesson.team.device
    with torch.no_grad():
        for number, sample in enumerate(in_order(lesson.frames.plain, range(lesson.frames.train))):
            batch = collate([sample], detector.grid).to(device)
            with half_precision(device, wanted=lesson.plan.half):
                output = detector(batch)
            (boxes,) = detections(detector, output, min_score=lesson.plan.trust, max_boxes=100, nms_iou=0.1)
            new = ~(iou_bev(boxes.seven, sample.boxes) > 0).any(axis=1)
            if new.any():
                yield number, boxes.seven[new]
    detector.train()


def _rate(step: int, plan: Plan) -> float:
    """The learning rate of a step: up in a line, down in a cosine."""
    warm = max(round(_WARM_UP * plan.steps), 1)
    if step < warm:
        return plan.rate * (step + 1) / warm
    return plan.rate * (1 + math.cos(math.pi * (step - warm) / max(plan.steps - warm, 1))) / 2


def _copied(detector: Detector) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().clone() for name, tensor in detector.state_dict().items()}


def _moments(optimizer: torch.optim.Optimizer, detector: Detector) -> dict[str, Tensor]:
    """What the optimizer keeps of each weight."""
    return {
        f"{kind}/{name}": tensor.detach().cpu().clone()
        for name, weight in detector.named_parameters()
        for kind, tensor in optimizer.state[weight].items()
    }


def _remember(optimizer: torch.optim.Optimizer, detector: Detector, moments: dict[str, Tensor]) -> None:
    names = [name for name, _ in detector.named_parameters()]
    kinds = {key.partition("/")[0] for key in moments}
    held = {
        number: {kind: moments[f"{kind}/{name}"].clone() for kind in kinds}
        for number, name in enumerate(names)
    }
    if moments:
        optimizer.load_state_dict({**optimizer.state_dict(), "state": held})


@contextmanager
def _repeatable(device: torch.device) -> Iterator[None]:
    """On a processor the same steps give the same bits."""
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
