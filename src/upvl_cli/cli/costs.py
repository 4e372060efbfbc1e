"""Print what labelling drives will take, and what it took."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from upvl_cli.commands.cost_estimate import CostEstimate, Prices, load_estimate, save_estimate
from upvl_cli.commands.cost_range import EXPECTED_INSIDE, CostRange
from upvl_cli.commands.estimate_cost import drives_to_sample, estimate_cost, sampled_drives
from upvl_cli.commands.true_costs import TrueCosts, true_costs
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace

_ENDS: tuple[Literal["mean"], Literal["low"], Literal["high"]] = ("mean", "low", "high")


def print_estimate(
    workspace: Workspace, *, drives: int | None, sample: int, workers: int, prices: Prices
) -> None:
    """Print what labelling drives will take, and keep it to be compared with what it takes.

    Raises:
        BadSetting: Too few drives have been labelled with the present settings.
    """
    if missing := drives_to_sample(workspace, sample):
        raise BadSetting(
            f"an estimate needs {sample} drives that are labelled with the present settings, {workspace.out} holds "
            f"{len(sampled_drives(workspace))}; label them where the others will be labelled: "
            f"{_autolabel(workspace, missing)}, then run this again"
        )
    estimate = estimate_cost(workspace, drives=drives, workers=workers, prices=prices)
    save_estimate(workspace, estimate)
    known = "" if estimate.opened == estimate.drives else f", by the length of {estimate.opened} drives"
    print(
        f"{_number(estimate.drives)} drives, {_number(round(estimate.frames))} frames{known}; from the runs of "
        f"{len(estimate.sample)} drives: {_names(estimate.sample)}"
    )
    Console().print(_estimate_table(estimate))
    for line in _notes(estimate):
        print(line)


def print_true_costs(workspace: Workspace) -> None:
    """Print what the shards took, beside what was estimated for as many frames."""
    estimate = load_estimate(workspace)
    costs = true_costs(workspace, estimate)
    hours, size = _hours_unit(costs.total.cpu_h), _bytes_unit(costs.total.size_bytes)
    Console().print(_true_table(costs, hours, size))
    if costs.again_cpu_h:
        print(
            f"runs whose shards were made again later took {hours.text(costs.again_cpu_h)} CPU {hours.name} more"
        )
    expected = costs.total.estimated
    if estimate is None or expected is None:
        print("nothing was estimated before: upvl plan --estimate")
        return
    if any(stage.estimated is None for stage in costs.stages):
        print("all: those stages that were estimated")
    # The parts of a total vary together or not as in the sample, which the total of the estimate knows.
    cpu = estimate.total.cpu_h * (expected.cpu_h.mean / (estimate.total.cpu_h.mean or 1.0))
    of_bytes = estimate.total.size_bytes * (
        expected.size_bytes.mean / (estimate.total.size_bytes.mean or 1.0)
    )
    share = expected.frames / estimate.frames
    print(
        f"{_PLAIN.text(100 * share)} % of the frames of {_number(estimate.drives)} drives: "
        f"{hours.text(costs.total.cpu_h)} CPU {hours.name}, estimated {_range(cpu, hours)}; "
        f"{size.text(costs.total.size_bytes)} {size.name}, estimated {_range(of_bytes, size)}"
    )
    if costs.cost is not None and estimate.cost is not None:
        print(f"cost: {_PLAIN.text(costs.cost)}, estimated {_range(estimate.cost * share, _PLAIN)}")


def _true_table(costs: TrueCosts, hours: _Unit, size: _Unit) -> Table:
    """Return the table of what each stage took; GPUs are left out where none was held."""
    gpu = (f"GPU {hours.name}",) if costs.total.gpu_h else ()
    table = _table(("shards", f"CPU {hours.name}", "estimate", *gpu, "GiB a worker", size.name, "estimate"))
    for stage in (*costs.stages, costs.total):
        expected = stage.estimated
        table.add_row(
            stage.stage,
            _number(stage.shards),
            hours.text(stage.cpu_h),
            hours.text(expected.cpu_h.mean) if expected else "",
            *(hours.text(stage.gpu_h) for _ in gpu),
            _gib(stage.peak_mib),
            size.text(stage.size_bytes),
            size.text(expected.size_bytes.mean) if expected else "",
        )
    return table


def _autolabel(workspace: Workspace, drives: tuple[str, ...]) -> str:
    """Return the command that labels drives as the workspace is set."""
    places = [
        word
        for option, folder in (("stages", workspace.stages), ("out", workspace.out))
        if folder != Path(option)
        for word in (f"--{option}", str(folder))
    ]
    modes = {"moving-only": ["--moving-only"], "without-words": ["--all-motion", "--no-pictures"]}
    words = ["upvl", *places, "autolabel", *modes.get(workspace.preset, ["--all-motion"])]
    return shlex.join([*words, *(word for drive in drives for word in ("-s", drive))])


def _estimate_table(estimate: CostEstimate) -> Table:
    """Return the table of what each stage will take; GPUs are left out where none is held."""
    hours, size = _hours_unit(estimate.total.cpu_h.mean), _bytes_unit(estimate.total.size_bytes.mean)
    gpu = (f"GPU {hours.name}",) if estimate.total.gpu_h.mean else ()
    table = _table((f"CPU {hours.name}", "from", "to", *gpu, "GiB a worker", size.name, "from", "to"))
    for stage in (*estimate.stages, estimate.total):
        table.add_row(
            stage.stage,
            *(hours.text(stage.cpu_h.at(end)) for end in _ENDS),
            *(hours.text(stage.gpu_h.mean) for _ in gpu),
            _gib(stage.peak_mib),
            *(size.text(stage.size_bytes.at(end)) for end in _ENDS),
        )
    return table


def _notes(estimate: CostEstimate) -> list[str]:
    share = round(100 * EXPECTED_INSIDE)
    notes = [
        f"in brackets: where the true figure is expected in {share} % of cases, by how the sampled drives differ"
    ]
    if estimate.has_cpu_time:
        elapsed = estimate.total.elapsed_h.mean
        cores = estimate.total.cpu_h.mean / elapsed if elapsed else 0.0
        notes.append(f"a worker of the sample kept {cores:.1f} cores busy on average")
    else:
        notes.append("the run log holds no processor time for the sample: elapsed time stands in for it")
    workers = (
        "1 worker"
        if estimate.workers == 1
        else f"{_number(estimate.workers)} workers like those of the sample"
    )
    wall = _hours_unit(estimate.wall_h.mean)
    notes.append(f"time from start to end with {workers}: {_range(estimate.wall_h, wall)} {wall.name}")
    if estimate.cost is not None:
        notes.append(
            f"cost, with one month of storage: {_range(estimate.cost, _PLAIN)}, in the currency of the prices"
        )
    return notes


def _table(columns: tuple[str, ...]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("stage")
    for name in columns:
        table.add_column(name, justify="right")
    return table


def _names(drives: tuple[str, ...]) -> str:
    return ", ".join(drives[:4]) + (", ..." if len(drives) > 4 else "")


def _gib(peak_mib: float | None) -> str:
    return "" if peak_mib is None else f"{peak_mib / 1024:.1f}"


def _range(values: CostRange, unit: _Unit) -> str:
    return f"{unit.text(values.mean)} ({unit.text(values.low)} to {unit.text(values.high)})"


def _number(value: float) -> str:
    """Return a whole number with its thousands apart."""
    return f"{value:,.0f}".replace(",", " ")


@dataclass(frozen=True)
class _Unit:
    """A unit to print in, and its size in the unit of the values."""

    name: str
    size: float

    def text(self, value: float) -> str:
        """Return a value in this unit, with about three digits."""
        number = value / self.size
        if 0 < number < 0.01:
            return "<0.01"
        return _number(number) if number >= 100 or number == 0 else f"{number:.{1 if number >= 10 else 2}f}"


_PLAIN = _Unit("", 1.0)


def _hours_unit(hours: float) -> _Unit:
    """Return the unit for a table whose total is that many hours."""
    if hours >= 1:
        return _Unit("h", 1.0)
    return _Unit("min", 1 / 60) if hours >= 1 / 60 else _Unit("s", 1 / 3600)


def _bytes_unit(size_bytes: float) -> _Unit:
    """Return the unit for a table whose total is that many bytes."""
    for name, size in (("TB", 1e12), ("GB", 1e9)):
        if size_bytes >= size:
            return _Unit(name, size)
    return _Unit("MB", 1e6)
