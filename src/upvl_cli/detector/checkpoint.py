"""Checkpoints of a training, and the bytes that a trained network is stored as."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import safetensors
import torch
from safetensors.torch import load, save
from torch import Tensor

from upvl_cli.config.toml import parse
from upvl_cli.detector.config import DetectorConfig
from upvl_cli.detector.model import Detector
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, Boxes

LOSSES = ("total", "objectness", "box", "heading", "distillation")
_TENSORS = ("model", "moments", "best")


@dataclass
class TrainState:
    """How far training is.

    Attributes:
        step: Steps done, over all rounds of self-training.
        model: Weights.
        moments: State of the optimizer for each weight, as `exp_avg/<name>`; empty before the first step.
        best: The weights of the lowest loss on held-out frames in this round; empty before the first check.
        lowest_loss: That loss.
        curve: (steps, 6) learning rate and losses, in the order of `LOSSES`, of each step.
        checks: (c, 2) step and loss on held-out frames of each check.
        pseudo_labels: Boxes that the round before detected, by number of the frame.
    """

    step: int = 0
    model: dict[str, Tensor] = field(default_factory=dict)
    moments: dict[str, Tensor] = field(default_factory=dict)
    best: dict[str, Tensor] = field(default_factory=dict)
    lowest_loss: float = float("inf")
    curve: list[list[float]] = field(default_factory=list)
    checks: list[list[float]] = field(default_factory=list)
    pseudo_labels: dict[int, Boxes] = field(default_factory=dict)


def save_checkpoint(path: Path, state: TrainState, stamp: str) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: The file to write.
        state: How far training is.
        stamp: What made the training: another one does not go on from this file.
    """
    labels = sorted(state.pseudo_labels.items())
    rows = [np.column_stack([np.full(len(boxes), frame), boxes.to_rows()]) for frame, boxes in labels]
    tensors = {f"{part}/{name}": tensor for part in _TENSORS for name, tensor in getattr(state, part).items()}
    tensors["curve"] = torch.tensor(state.curve, dtype=torch.float64).reshape(-1, 1 + len(LOSSES))
    tensors["checks"] = torch.tensor(state.checks, dtype=torch.float64).reshape(-1, 2)
    tensors["pseudo_labels"] = torch.from_numpy(np.concatenate([np.zeros((0, 8)), *rows]))
    header = json.dumps({"step": state.step, "lowest_loss": state.lowest_loss, "stamp": stamp})
    with atomic_file(path) as file:
        file.write(save({name: tensor.contiguous() for name, tensor in tensors.items()}, {"upvl": header}))


def load_checkpoint(path: Path, stamp: str) -> TrainState | None:
    """Return the state in a checkpoint; None where there is none, a damaged one, or one of another training."""
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})["upvl"])
            if header["stamp"] != stamp:
                return None
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        state = TrainState(step=int(header["step"]), lowest_loss=float(header["lowest_loss"]))
        for part in _TENSORS:
            prefix = f"{part}/"
            of_part = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
            setattr(state, part, of_part)
        state.curve, state.checks = tensors["curve"].tolist(), tensors["checks"].tolist()
        rows = tensors["pseudo_labels"].numpy()
        state.pseudo_labels = {
            int(frame): Boxes.from_rows(rows[rows[:, 0] == frame, 1:]) for frame in np.unique(rows[:, 0])
        }
        return state
    except (OSError, safetensors.SafetensorError, KeyError, ValueError, TypeError):
        return None


def pack_weights(weights: dict[str, Tensor]) -> Array:
    """Return (n,) uint8, weights as a file of safetensors."""
    return np.frombuffer(save({name: tensor.contiguous() for name, tensor in weights.items()}), np.uint8)


def pack_config(config: DetectorConfig) -> str:
    """Return as JSON what a network is built from and fed with."""
    return json.dumps(config.values())


def unpack_config(text: str) -> DetectorConfig:
    """Return what `pack_config` gave."""
    return parse(DetectorConfig, json.loads(text), Path("out/train"))


def unpack_detector(weights: Array, config: DetectorConfig, has_distillation_head: bool) -> Detector:
    """Return the network of `pack_weights`, ready to detect.

    Raises:
        RuntimeError: The weights are those of another network.
    """
    detector = Detector(config, has_distillation_head)
    detector.load_state_dict(load(weights.tobytes()), strict=True)
    return detector.train(False)
