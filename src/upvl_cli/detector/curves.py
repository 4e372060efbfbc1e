"""A picture of the losses of a training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from upvl_cli.detector.checkpoint import LOSSES
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Floats, Ints


def draw(
    path: Path, losses: dict[str, Floats], learning_rate: Floats, check_step: Ints, check_total: Floats
) -> None:
    """Draw the losses of each step, and those on held-out frames.

    Args:
        path: The PNG to write.
        losses: (n,) of each step, by the names in `LOSSES`.
        learning_rate: (n,) learning rates.
        check_step: (c,) steps done at each check on the held-out frames.
        check_total: (c,) loss at each check.
    """
    figure = Figure(figsize=(8, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    step = np.arange(1, len(learning_rate) + 1)
    for name in LOSSES:
        if losses[name].any():
            above.plot(step, _smooth(losses[name]), label=name, linewidth=2 if name == "total" else 1)
    if len(check_step):
        above.plot(check_step, check_total, "k.-", label="held out")
    above.set(ylabel="loss", ylim=(0, None))
    above.legend(frameon=False)
    below.plot(step, learning_rate)
    below.set(xlabel="step", ylabel="learning rate", ylim=(0, None))
    with atomic_file(path) as file:
        # Without the name of the library's version: the same losses give the same bytes.
        figure.savefig(file, format="png", metadata={"Software": None})


def _smooth(values: Floats) -> Floats:
    """Return the running mean over the last hundredth of all steps: single batches scatter."""
    window = max(len(values) // 100, 1)
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(1, len(values) + 1) - window, 0)
    last = np.arange(1, len(values) + 1)
    return np.asarray((total[last] - total[first]) / (last - first))
