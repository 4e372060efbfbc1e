"""What labelling will take: scaled from a sample by frames, with a range that holds what it says."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t

from command import fails, make_workspace, upvl
from upvl_cli.commands.cost_estimate import Prices, load_estimate, save_estimate
from upvl_cli.commands.cost_range import EXPECTED_INSIDE, CostRange, from_sample
from upvl_cli.commands.estimate_cost import (
    drives_to_sample,
    estimate_cost,
    sampled_drives,
)
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.commands.true_costs import true_costs
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.run_log import RunRecord, log_run, settings_digest
from upvl_cli.pipeline.runner import claim_folder, make_shard
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace
from world.street import Streets

DRIVES = tuple(f"train-{number:03d}" for number in range(6))
OF_DRIVES = [stage for stage in PIPELINE.labelling_stages if not stage.is_of_dataset]
ONCE = [stage for stage in PIPELINE.labelling_stages if stage.is_of_dataset]


@pytest.fixture
def city(tmp_path: Path) -> Workspace:
    """Six drives of 40 frames, none of them labelled."""
    folder = make_workspace(tmp_path, raw__dataset='"synthetic"', synthetic__train="6")
    (folder / "out").mkdir()
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def log(city: Workspace, drives: Sequence[str], **values: float) -> None:
    """Log that each labelling stage took 40 s of processor time on each drive, and 20 s elapsed; pca 60 s once."""
    for drive in drives:
        for stage in OF_DRIVES:
            record = RunRecord(stage.name, drive, 40, 20.0, 40.0, 0.0, 1024.0, 4_000_000, 0, "host", 1.0)
            log_run(city.out, dataclasses.replace(record, **values))
    for stage in ONCE:
        log_run(
            city.out, RunRecord(stage.name, WHOLE_DATASET, 1, 30.0, 60.0, 0.0, 2048.0, 1000, 0, "host", 1.0)
        )


def test_equal_drives_are_scaled_by_frames_with_the_smallest_range() -> None:
    found = from_sample([3.0, 6.0], [30, 60], 900.0, drives=10, length_error=0.0, smallest=math.log(1.1))
    assert (found.low, found.mean, found.high) == pytest.approx((90 / 1.1, 90, 90 * 1.1))


def test_the_range_is_students_interval_of_the_logarithms() -> None:
    rates = np.array([1.0, 1.5, 2.0])
    found = from_sample(list(rates * 10), [10, 10, 10], 1000.0, drives=100, length_error=0.0, smallest=0.0)
    expected = t.ppf(0.9, 2) * np.log(rates).std(ddof=1) * math.sqrt(1 / 3 + 1 / 100)
    assert found.mean == pytest.approx(1500.0)
    assert math.log(found.high / found.mean) == pytest.approx(expected)
    assert math.log(found.mean / found.low) == pytest.approx(expected)


@pytest.mark.parametrize("sampled", [2, 4])
def test_the_true_figure_is_inside_as_often_as_is_printed(sampled: int) -> None:
    """Drives whose costs differ by factors, 50 of them: the total is in the range of most samples."""
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(600):
        costs = rng.lognormal(0.0, 0.3, 50)
        found = from_sample(
            list(costs[:sampled]), [1] * sampled, 50.0, drives=50, length_error=0.0, smallest=0.0
        )
        inside.append(found.low <= costs.sum() <= found.high)
    assert statistics.fmean(inside) == pytest.approx(EXPECTED_INSIDE, abs=0.06)


def test_an_uncertain_length_widens_the_range() -> None:
    narrow, wide = (
        from_sample([1.0, 1.1], [1, 1], 10.0, drives=10, length_error=error, smallest=0.0)
        for error in (0.0, 0.5)
    )
    assert wide.high > narrow.high
    assert wide.mean == narrow.mean


def test_a_stage_that_took_nothing_is_estimated_at_nothing() -> None:
    assert from_sample([0.0, 0.0], [1, 1], 9.0, drives=9, length_error=0.0, smallest=0.1) == CostRange(
        0.0, 0.0, 0.0
    )


def test_a_sample_is_scaled_to_the_drives_that_are_asked_for(city: Workspace) -> None:
    log(city, DRIVES[:2])
    found = estimate_cost(city, drives=900, workers=30, prices=Prices(cpu_hour=0.1, tb_month=20.0))
    hours = len(OF_DRIVES) * 900 * 40 / 3600 + len(ONCE) * 60 / 3600
    assert found.total.cpu_h.mean == pytest.approx(hours)
    assert found.frames == 36_000
    assert {stage.stage: round(stage.cpu_h.mean, 6) for stage in found.stages}["flow"] == 10.0
    assert found.total.peak_mib == 2048.0
    tb = len(OF_DRIVES) * 900 * 4e6 / 1e12
    assert found.cost is not None
    assert found.cost.mean == pytest.approx(0.1 * hours + 20 * tb, rel=1e-6)
    assert found.wall_h.mean == pytest.approx(len(OF_DRIVES) * 900 * 20 / 3600 / 30 + len(ONCE) * 30 / 3600)
    assert found.has_cpu_time


def test_more_workers_than_drives_wait_for_the_longest_drive(city: Workspace) -> None:
    log(city, DRIVES[:2])
    found = estimate_cost(city, workers=1000)
    assert found.wall_h.mean == pytest.approx((len(OF_DRIVES) * 20 + len(ONCE) * 30) / 3600)


def test_without_prices_there_is_no_cost(city: Workspace) -> None:
    log(city, DRIVES[:2])
    assert estimate_cost(city).cost is None


def test_runs_with_other_settings_are_no_sample(city: Workspace) -> None:
    log(city, DRIVES[:2])
    changed = OF_DRIVES[2]
    log_run(city.out, RunRecord(changed.name, DRIVES[0], 40, 5.0, 5.0, settings="0123456789ab", end=2.0))
    assert sampled_drives(city) == (DRIVES[1],)
    present = settings_digest(city.stage_stamp(changed))
    log_run(city.out, RunRecord(changed.name, DRIVES[0], 40, 5.0, 5.0, settings=present, end=3.0))
    assert sampled_drives(city) == DRIVES[:2]


def test_drives_to_sample_are_spread_and_none_is_named_twice(city: Workspace) -> None:
    assert drives_to_sample(city, 2) == (DRIVES[1], DRIVES[4])
    log(city, DRIVES[:1])
    assert drives_to_sample(city, 2) == (DRIVES[3],)
    assert drives_to_sample(city, 99) == DRIVES[1:]
    log(city, DRIVES[1:2])
    assert drives_to_sample(city, 2) == ()
    with pytest.raises(BadSetting, match="needs two labelled drives"):
        estimate_cost(city, sample=DRIVES[:1])


def test_a_log_without_processor_time_is_said_to_hold_none(city: Workspace) -> None:
    log(city, DRIVES[:2], cpu_s=None)
    found = estimate_cost(city)
    assert not found.has_cpu_time
    assert found.total.cpu_h.mean == pytest.approx((len(OF_DRIVES) * 6 * 20 + len(ONCE) * 60) / 3600)


def test_an_estimate_is_read_back_as_it_was_and_a_damaged_one_is_refused(city: Workspace) -> None:
    assert load_estimate(city) is None
    log(city, DRIVES[:2])
    found = estimate_cost(city, prices=Prices(gpu_hour=2.0))
    save_estimate(city, found)
    assert load_estimate(city) == found
    text = (city.out / "estimate.json").read_text()
    for damage in (
        "",
        "[]",
        text[:-40],
        text.replace("wall_h", "wall"),
        text.replace('"stages": [', '"stages": [3,'),
    ):
        (city.out / "estimate.json").write_text(damage)
        with pytest.raises(BadInput, match="is damaged; make it anew: upvl plan --estimate"):
            load_estimate(city)


def test_true_costs_stand_beside_the_estimate_for_as_many_frames(city: Workspace) -> None:
    log(city, DRIVES[:2])
    estimate = estimate_cost(city, prices=Prices(cpu_hour=0.1))
    log(city, DRIVES[2:4], cpu_s=60.0, end=2.0)
    log(city, DRIVES[2:3], cpu_s=80.0, end=3.0)  # made again
    costs = true_costs(city, estimate)
    flow = next(stage for stage in costs.stages if stage.stage == "flow")
    assert flow.shards == 4
    assert flow.cpu_h == pytest.approx((40 + 40 + 80 + 60) / 3600)
    assert flow.estimated is not None
    assert flow.estimated.cpu_h.mean == pytest.approx(4 * 40 / 3600)
    assert costs.again_cpu_h == pytest.approx((60 * len(OF_DRIVES) + 2 * 60 * len(ONCE)) / 3600)
    assert costs.cost == pytest.approx(0.1 * costs.total.cpu_h)


def test_plan_names_the_command_that_makes_the_sample(city: Workspace) -> None:
    assert fails(city.stages.parent, "plan", "--estimate") == (
        "upvl: an estimate needs 2 drives that are labelled with the present settings, out holds 0; label them where "
        "the others will be labelled: upvl autolabel --all-motion -s train-001 -s train-004, then run this again"
    )
    assert "need --estimate" in fails(city.stages.parent, "plan", "--drives", "3")


def test_plan_prints_the_estimate_and_status_the_true_figures(city: Workspace) -> None:
    folder = city.stages.parent
    log(city, DRIVES[:2])
    done = upvl(
        folder, "plan", "--estimate", "--drives", "10000", "--workers", "64", "--price-cpu-hour", "0.05"
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith(
        "10 000 drives, 400 000 frames, by the length of 6 drives; from the runs of 2 drives: "
    )
    assert lines[1].split() == ["stage", "CPU", "h", "from", "to", "GiB", "a", "worker", "GB", "from", "to"]
    assert next(line for line in lines if line.startswith("flow")).split()[:4] == [
        "flow",
        "111",
        "101",
        "122",
    ]
    assert any(line.startswith("time from start to end with 64 workers") for line in lines)
    assert lines[-1].startswith("cost, with one month of storage: ")
    done = upvl(folder, "status", "--cost")
    assert done.returncode == 0, done.stderr
    assert next(line for line in done.stdout.splitlines() if line.startswith("flow")).split()[1:4] == [
        "2", "1.33", "1.33",
    ]  # fmt: skip
    assert "0.02 % of the frames of 10 000 drives: " in done.stdout


def test_status_prints_what_shards_took_without_an_estimate(city: Workspace) -> None:
    log(city, DRIVES[:2])
    done = upvl(city.stages.parent, "status", "--cost")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "nothing was estimated before: upvl plan --estimate"


@pytest.mark.slow
def test_an_estimate_from_two_of_four_streets_holds_the_true_figures(tmp_path: Path) -> None:
    """Streets that are labelled for real: the figures of all lie in the range that two of them gave."""
    folder = make_workspace(tmp_path)
    streets = dataclasses.replace(PIPELINE, dataset=lambda name: _FiveStreets())
    workspace = Workspace(streets, folder / "stages", folder / "out")
    stages = workspace.pipeline.labelling_stages
    settings = {stage.name: claim_folder(workspace, stage, {}) for stage in stages}

    def label(drives: Sequence[str]) -> None:
        for stage in stages:
            for drive in (WHOLE_DATASET,) if stage.is_of_dataset else drives:
                make_shard(workspace, stage, drive, settings[stage.name], lambda: None)

    label(workspace.segments[:1])  # the first run of all loads libraries: it is no sample
    (workspace.out / "runs.jsonl").unlink()
    label(workspace.segments[1:3])
    estimate = estimate_cost(workspace, drives=4)
    label(workspace.segments[3:])
    costs = true_costs(workspace, estimate)
    assert costs.total.shards == 4 * sum(not stage.is_of_dataset for stage in stages)
    assert estimate.total.cpu_h.low <= costs.total.cpu_h <= estimate.total.cpu_h.high
    assert estimate.total.size_bytes.low <= costs.total.size_bytes <= estimate.total.size_bytes.high


class _FiveStreets:
    """A dataset adapter of five short streets."""

    config = None

    @staticmethod
    def open(root: Path, config: None) -> Streets:
        return Streets(frames=8, seeds=(0, 1, 2, 3, 4))
