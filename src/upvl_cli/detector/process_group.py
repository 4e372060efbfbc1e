"""Several processes that train together, as `torchrun` starts them; one process alone is a group of size 1."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import Tensor, distributed

_TIMEOUT = timedelta(days=1)  # the first process may first read every sweep


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
