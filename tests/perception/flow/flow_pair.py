"""Errors of a flow on a real pair of sweeps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from upvl_cli.metrics.flow import FlowErrors, flow_errors
from upvl_cli.types import Array


def errors_on_pair(path: Path, flow_mps: Callable[[Array, Array, float], Array]) -> FlowErrors:
    """Score a flow in m/s from the first to the second sweep of a pair, as Argoverse 2 does."""
    pair = np.load(path)
    dt_s = float(pair["dt"])
    found = flow_mps(pair["pc0"].astype(np.float64), pair["pc1"].astype(np.float64), dt_s)
    return flow_errors(
        found * dt_s,
        pair["gt_flow"],
        true_total_m=pair["gt_flow_total"],
        foreground=pair["classes"] > 0,
        dynamic=pair["is_dynamic"],
        evaluated=pair["is_valid"] & ~pair["is_ground"] & pair["is_close"],
    )
