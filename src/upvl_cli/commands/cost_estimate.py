"""What labelling many drives is estimated to take, and the file that keeps it beside the shards."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from upvl_cli.commands.cost_range import CostRange
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed

FILE = "estimate.json"
_TB = 1e12


@dataclass(frozen=True)
class Prices:
    """What the user pays, in any currency; None where it is not asked for.

    Attributes:
        cpu_hour: An hour of one processor core.
        gpu_hour: An hour of one GPU.
        tb_month: Storing a terabyte (1e12 bytes) for a month.
    """

    cpu_hour: float | None = None
    gpu_hour: float | None = None
    tb_month: float | None = None

    def cost(self, cpu_h: float, gpu_h: float, size_bytes: float) -> float | None:
        """Return what hours and a month of storing bytes cost; None without any price."""
        if self == NO_PRICES:
            return None
        hours = cpu_h * (self.cpu_hour or 0.0) + gpu_h * (self.gpu_hour or 0.0)
        return hours + size_bytes / _TB * (self.tb_month or 0.0)


NO_PRICES = Prices()


@dataclass(frozen=True)
class StageEstimate:
    """What the shards of one stage will take, or those of all stages.

    Attributes:
        stage: Its name.
        frames: Frames of its shards; 0 for a stage that is made once for all drives.
        cpu_h: Hours of processor time.
        gpu_h: Hours in which a GPU is held.
        elapsed_h: Hours on one worker.
        peak_mib: Largest resident memory of a worker in the sample; None where the log does not hold it.
        size_bytes: Size of the shards.
    """

    stage: str
    frames: float
    cpu_h: CostRange
    gpu_h: CostRange
    elapsed_h: CostRange
    peak_mib: float | None
    size_bytes: CostRange

    @classmethod
    def sum(cls, name: str, parts: Sequence[StageEstimate]) -> StageEstimate:
        """Return what several stages take, with the frames of the first."""
        peaks = [part.peak_mib for part in parts if part.peak_mib is not None]
        return cls(
            name, parts[0].frames,
            cpu_h=CostRange.sum(part.cpu_h for part in parts),
            gpu_h=CostRange.sum(part.gpu_h for part in parts),
            elapsed_h=CostRange.sum(part.elapsed_h for part in parts),
            peak_mib=max(peaks, default=None),
            size_bytes=CostRange.sum(part.size_bytes for part in parts),
        )  # fmt: skip

    def scaled(self, share: float) -> StageEstimate:
        """Return what a share of the frames takes; memory does not depend on it."""
        return StageEstimate(
            self.stage, self.frames * share, self.cpu_h * share, self.gpu_h * share, self.elapsed_h * share,
            self.peak_mib, self.size_bytes * share,
        )  # fmt: skip


@dataclass(frozen=True)
class CostEstimate:
    """What labelling some number of drives will take.

    Attributes:
        drives: Their number.
        frames: Their frames.
        opened: Number of drives whose length is known; the others are taken to be as long on average.
        sample: Names of the drives whose runs it was made from.
        workers: Number of workers.
        prices: What the user pays.
        stages: What each stage takes, in order.
        total: What all stages take together.
        wall_h: Hours from start to end.
        cost: What it costs; None without prices.
        has_cpu_time: Whether the log holds processor time; elapsed time stands in where it does not.
    """

    drives: int
    frames: float
    opened: int
    sample: tuple[str, ...]
    workers: int
    prices: Prices
    stages: tuple[StageEstimate, ...]
    total: StageEstimate
    wall_h: CostRange
    cost: CostRange | None
    has_cpu_time: bool


def save_estimate(workspace: Workspace, estimate: CostEstimate) -> None:
    """Keep an estimate in the folder of the shards, to be compared with what the run takes."""
    write_if_changed(workspace.out / FILE, json.dumps(asdict(estimate), indent=1) + "\n")


def load_estimate(workspace: Workspace) -> CostEstimate | None:
    """Return the estimate that is kept beside the shards; None where there is none.

    Raises:
        BadInput: The file is damaged.
    """
    path = workspace.out / FILE
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return None
    except ValueError as error:
        raise _damaged(workspace) from error
    try:
        return _estimate_of(json.loads(text))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise _damaged(workspace) from error


def _damaged(workspace: Workspace) -> BadInput:
    return BadInput(f"{workspace.out / FILE} is damaged; make it anew: upvl plan --estimate")


def _estimate_of(values: dict[str, Any]) -> CostEstimate:
    """Return an estimate from the values of its file."""
    stages = tuple(_stage_of(stage) for stage in values.pop("stages"))
    cost = values.pop("cost")
    return CostEstimate(
        stages=stages,
        total=_stage_of(values.pop("total")),
        prices=Prices(**values.pop("prices")),
        wall_h=CostRange(**values.pop("wall_h")),
        cost=None if cost is None else CostRange(**cost),
        sample=tuple(values.pop("sample")),
        **values,
    )


def _stage_of(values: dict[str, Any]) -> StageEstimate:
    ranges = ("cpu_h", "gpu_h", "elapsed_h", "size_bytes")
    return StageEstimate(**values | {name: CostRange(**values[name]) for name in ranges})
