"""Sums in one order on a CPU with any number of threads, and on a GPU."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from upvl_cli.errors import BadSetting

CUBLAS_VARIABLE = "CUBLAS_WORKSPACE_CONFIG"  # without it the sums of cuBLAS have no fixed order


class _FormerSettings:
    """What torch was set to before the first of the calls that are at work."""

    lock = threading.Lock()
    calls = 0
    threads = 1
    deterministic = False


@contextmanager
def fixed_order_of_sums(device: str) -> Iterator[None]:
    """Compute with one thread, so that sums have one order; a stage shares its pairs of sweeps among the cores.

    Torch's settings are of the process, some also of the thread: each call makes them, and the last one that is at
    work takes them back.

    Args:
        device: "cpu" or "cuda".

    Raises:
        BadSetting: There is no GPU that torch can use.
    """
    if device == "cuda":
        if not torch.cuda.is_available():
            raise BadSetting('flow.toml: device = "cuda", but torch finds no GPU; set device = "cpu"')
        os.environ.setdefault(CUBLAS_VARIABLE, ":4096:8")
    former = _FormerSettings
    with former.lock:
        if not former.calls:
            former.threads = torch.get_num_threads()
            former.deterministic = torch.are_deterministic_algorithms_enabled()
        former.calls += 1
        torch.set_num_threads(1)
        torch.use_deterministic_algorithms(device == "cuda")
    try:
        yield
    finally:
        with former.lock:
            former.calls -= 1
            if not former.calls:
                torch.set_num_threads(former.threads)
                torch.use_deterministic_algorithms(former.deterministic)
