"""Checkpoints of a training, and the bytes that a trained network is stored as."""

from __future__ import annotations

import json
from collections.abc import Mapping
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


def pack_checkpoint(state: TrainState, stamp: str) -> bytes:
    """Return the bytes of a checkpoint, which any number of processes can go on from.

    Args:
        state: How far training is.
        stamp: What made the training: another one does not go on from these bytes.
    """
    tensors = {f"{part}/{name}": tensor for part in _TENSORS for name, tensor in getattr(state, part).items()}
    tensors["curve"] = torch.tensor(state.curve, dtype=torch.float64).reshape(-1, 1 + len(LOSSES))
    tensors["checks"] = torch.tensor(state.checks, dtype=torch.float64).reshape(-1, 2)
    tensors["pseudo_labels"] = torch.from_numpy(rows_of_frames(state.pseudo_labels))
    header = json.dumps({"step": state.step, "lowest_loss": state.lowest_loss, "stamp": stamp})
    return save({name: tensor.contiguous() for name, tensor in tensors.items()}, {"upvl": header})


def save_checkpoint(path: Path, state: TrainState, stamp: str) -> None:
    """Write a checkpoint, whole or not at all."""
    with atomic_file(path) as file:
        file.write(pack_checkpoint(state, stamp))


def unpack_checkpoint(data: bytes, stamp: str) -> TrainState | None:
    """Return the state in a checkpoint; None where there is none, a damaged one, or one of another training."""
    try:
        tensors = load(data)
        length = int.from_bytes(data[:8], "little")  # of the header, which `load` checks
        header = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["upvl"])
        if header["stamp"] != stamp:
            return None
        state = TrainState(step=int(header["step"]), lowest_loss=float(header["lowest_loss"]))
        for part in _TENSORS:
            prefix = f"{part}/"
            of_part = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
            setattr(state, part, of_part)
        state.curve, state.checks = tensors["curve"].tolist(), tensors["checks"].tolist()
        state.pseudo_labels = boxes_by_frame(tensors["pseudo_labels"].numpy())
        return state
    except (safetensors.SafetensorError, KeyError, ValueError, TypeError):
        return None


def load_checkpoint(path: Path, stamp: str) -> TrainState | None:
    """Return the state in a file of `save_checkpoint`; None as in `unpack_checkpoint`, or where there is no file."""
    try:
        return unpack_checkpoint(path.read_bytes(), stamp)
    except OSError:
        return None


def rows_of_frames(boxes: Mapping[int, Boxes]) -> Array:
    """Return (n, 8) the number of the frame and the box, of each box, in ascending order of frames."""
    frames = sorted(boxes.items())
    rows = [np.column_stack([np.full(len(held), frame), held.to_rows()]) for frame, held in frames]
    return np.concatenate([np.zeros((0, 8)), *rows])


def boxes_by_frame(rows: Array) -> dict[int, Boxes]:
    """Return what `rows_of_frames` was given."""
    order = np.argsort(rows[:, 0], kind="stable")
    frames, start = np.unique(rows[order, 0], return_index=True)
    parts = np.split(rows[order, 1:], start[1:])
    return {int(frame): Boxes.from_rows(part) for frame, part in zip(frames, parts, strict=False)}


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
