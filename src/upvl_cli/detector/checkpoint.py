"""What is kept of training: the weights as bytes, and on the way all that going on from there needs."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import safetensors
import torch
from safetensors.torch import load, save
from torch import Tensor

from upvl_cli.detector.batch import Grid
from upvl_cli.detector.model import Detector
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array

LOSSES = ("total", "objectness", "box", "heading", "distil")


@dataclass
class State:
    """How far training is.

    Attributes:
        step: Steps done, over all rounds.
        model: Weights.
        moments: What the optimizer keeps of each weight, as `exp_avg/<name>`; empty before the first step.
        best: The weights of the lowest loss on held-out frames in this round; empty before the first look.
        lowest: That loss.
        curve: (steps, 6) of each step the rate and the losses in the order of `LOSSES`.
        checks: (c, 2) step and loss on held-out frames of each look.
        found: Boxes that an earlier round found, by number of the frame; each (m, 7).
    """

    step: int = 0
    model: dict[str, Tensor] = field(default_factory=dict)
    moments: dict[str, Tensor] = field(default_factory=dict)
    best: dict[str, Tensor] = field(default_factory=dict)
    lowest: float = float("inf")
    curve: list[list[float]] = field(default_factory=list)
    checks: list[list[float]] = field(default_factory=list)
    found: dict[int, Array] = field(default_factory=dict)


def keep(path: Path, state: State, stamp: str) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: Where.
        state: How far training is.
        stamp: What it belongs to.
    """
    rows = [np.column_stack([np.full(len(boxes), n), boxes]) for n, boxes in sorted(state.found.items())]
    tensors = {f"{part}/{name}": tensor for part in ("model", "moments", "best")
               for name, tensor in getattr(state, part).items()}  # fmt: skip
    tensors["curve"] = torch.tensor(state.curve, dtype=torch.float64).reshape(-1, 1 + len(LOSSES))
    tensors["checks"] = torch.tensor(state.checks, dtype=torch.float64).reshape(-1, 2)
    tensors["found"] = torch.from_numpy(np.concatenate([np.zeros((0, 8)), *rows]))
    told = json.dumps({"step": state.step, "lowest": state.lowest, "stamp": stamp})
    with atomic_file(path) as file:
        file.write(save({name: tensor.contiguous() for name, tensor in tensors.items()}, {"upvl": told}))


def resume(path: Path, stamp: str) -> State | None:
    """Read a checkpoint; None where there is none, none that is whole, or one of another training."""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            told = json.loads((file.metadata() or {})["upvl"])
            if told["stamp"] != stamp:
                return None
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        state = State(step=int(told["step"]), lowest=float(told["lowest"]))
        for part in ("model", "moments", "best"):
            kept = {n.removeprefix(f"{part}/"): t for n, t in tensors.items() if n.startswith(f"{part}/")}
            setattr(state, part, kept)
        state.curve, state.checks = tensors["curve"].tolist(), tensors["checks"].tolist()
        found = tensors["found"].numpy()
        state.found = {int(n): found[found[:, 0] == n, 1:] for n in np.unique(found[:, 0])}
        return state
    except (OSError, safetensors.SafetensorError, KeyError, ValueError, TypeError):
        return None


def packed(weights: dict[str, Tensor]) -> Array:
    """Return (n,) uint8, weights as a file of safetensors."""
    return np.frombuffer(save({name: tensor.contiguous() for name, tensor in weights.items()}), np.uint8)


def rebuilt(weights: Array, grid: Grid, width: int, encoder: str, distils: bool) -> Detector:
    """Return the network that `packed` weights belong to, ready to detect."""
    detector = Detector(grid, width, encoder, distils)
    detector.load_state_dict(load(weights.tobytes()), strict=True)
    return detector.train(False)
