"""Sums in one order on a CPU with any number of threads, and on a GPU."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from upvl_cli.errors import BadSetting

CUBLAS_VARIABLE = "CUBLAS_WORKSPACE_CONFIG"  # without it the sums of cuBLAS have no fixed order


@contextmanager
def fixed_order_of_sums(device: str) -> Iterator[None]:
    """Compute with one thread, so that sums have one order; a stage shares its pairs of sweeps among the cores.

    Args:
        device: "cpu" or "cuda".

    Raises:
        BadSetting: There is no GPU that torch can use.
    """
    if device == "cuda":
        if not torch.cuda.is_available():
            raise BadSetting('flow.toml: device = "cuda", but torch finds no GPU; set device = "cpu"')
        os.environ.setdefault(CUBLAS_VARIABLE, ":4096:8")
    # These settings are of the process, some also of the thread: each call makes them, and none takes them back
    # while another thread is at work. A stage that wants more threads asks for them.
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(device == "cuda")
    yield
