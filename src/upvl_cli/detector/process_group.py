"""Several processes that train together, as `torchrun` starts them; one process alone is a group of size 1."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import numpy as np
import torch
from torch import Tensor, distributed

from upvl_cli.types import Array

# A process that waits longer for the others takes them for dead. The first step waits for the first frames of all.
_TIMEOUT = timedelta(hours=1)


@dataclass(frozen=True)
class ProcessGroup:
    """The processes of a training.

    Attributes:
        rank: Number of this one.
        size: How many there are.
        device: Where this one computes.
    """

    rank: int
    size: int
    device: torch.device

    def average(self, values: Iterable[Tensor]) -> None:
        """Replace tensors by their means over all processes."""
        tensors = list(values)
        if self.size > 1 and tensors:
            flat = torch.cat([tensor.flatten() for tensor in tensors])
            distributed.all_reduce(flat)
            flat /= self.size
            for tensor, part in zip(tensors, torch.split(flat, [t.numel() for t in tensors]), strict=True):
                tensor.copy_(part.view_as(tensor))

    def share(self, total: int) -> range:
        """Return which of a number of things are this process's: nearly as many as of each other."""
        return range(self.rank * total // self.size, (self.rank + 1) * total // self.size)

    def concat(self, rows: Array) -> Array:
        """Return the rows of all processes, (n, width) each, one process after the other."""
        if self.size == 1:
            return rows
        counts = torch.zeros(self.size, dtype=torch.int64, device=self.device)
        counts[self.rank] = len(rows)
        distributed.all_reduce(counts)
        padded = torch.zeros((int(counts.max()), rows.shape[1]), dtype=torch.float64)
        padded[: len(rows)] = torch.from_numpy(np.ascontiguousarray(rows, dtype=np.float64))
        found = [torch.empty_like(padded, device=self.device) for _ in range(self.size)]
        distributed.all_gather(found, padded.to(self.device))
        return np.concatenate(
            [part[:count].cpu().numpy() for part, count in zip(found, counts.tolist(), strict=True)]
        )

    def broadcast(self, data: bytes) -> bytes:
        """Return the bytes that the first process gives; what the others give is not read."""
        if self.size == 1:
            return data
        length = torch.tensor([len(data)], dtype=torch.int64, device=self.device)
        distributed.broadcast(length, 0)
        held = torch.zeros(int(length), dtype=torch.uint8)
        if self.rank == 0 and data:
            held = torch.frombuffer(bytearray(data), dtype=torch.uint8)
        held = held.to(self.device)
        distributed.broadcast(held, 0)
        return held.cpu().numpy().tobytes()

    def wait(self) -> None:
        """Return when all processes have called this."""
        if self.size > 1:
            distributed.barrier()


def half_precision(device: torch.device, *, enabled: bool) -> torch.autocast:
    """Return a context that convolves in bfloat16 where the device has units for it, as CUDA and AMX do.

    Args:
        device: Where the network computes.
        enabled: Whether bfloat16 is allowed at all.
    """
    has_units = device.type == "cuda" or torch.cpu.get_capabilities().get("amx_bf16", False)
    return torch.autocast(device.type, torch.bfloat16, enabled=enabled and has_units)


@contextmanager
def process_group() -> Iterator[ProcessGroup]:
    """Yield the processes that `torchrun` started with this one, connected; this one alone without it."""
    size, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
    local_rank = int(os.environ.get("LOCAL_RANK", "0"))
    device = torch.device("cuda", local_rank) if torch.cuda.is_available() else torch.device("cpu")
    if size > 1:
        if device.type == "cuda":
            torch.cuda.set_device(device)
        distributed.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=_TIMEOUT)
    try:
        yield ProcessGroup(rank, size, device)
    finally:
        if size > 1:
            distributed.destroy_process_group()
