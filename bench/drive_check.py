"""What the checks of poses, axes and motion compensation say of drives with faults made on purpose.

    python bench/drive_check.py ../shared/data/kitti_raw_b --city 0 3 [--fewer-beams 4] [--quick] [--only WORDS]

Prints a line a drive and fault: the worst level, whether the finding names the fault, the seconds of one core, and the
finding. "right" is the drive as it is. --fewer-beams adds each KITTI drive as seen by each n-th beam.
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when numpy is imported

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from drive_faults import FAULTS, Case, fewer_beams
from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.perception.drive_check.finding import LEVELS, Finding
from upvl_cli.perception.drive_check.motion_check import check_motion
from upvl_cli.perception.drive_check.sample import DriveSample, spread_runs
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.types import Drive

STAGES = Path(__file__).parents[1] / "stages"
CONFIG = load(CheckConfig, STAGES / "check.toml")


def sample(drive: Drive, *, quick: bool) -> DriveSample:
    """Return the sample of a drive that the check looks at."""
    extent = CONFIG.quick if quick else CONFIG.sample
    return DriveSample(
        frames=drive.frames,
        world_from_ego=drive.world_from_ego,
        ground_z_m=drive.ground_z_m,
        cameras=(),
        runs=spread_runs(len(drive.frames), extent.runs, extent.sweeps),
        sweep=lru_cache(64)(lambda step: drive.points(drive.frames[step].index)),
        picture=lambda step, camera: None,
    )


def drives(options: argparse.Namespace) -> Iterator[tuple[str, Drive]]:
    """Yield the drives that were asked for, by name."""
    for folder in options.folders:
        dataset = dataset_family(options.dataset).open(folder, None)
        for segment in dataset.segments:
            drive = dataset.open(segment)
            yield folder.name, drive
            if options.fewer_beams:
                yield f"{folder.name} 1/{options.fewer_beams} beams", fewer_beams(drive, options.fewer_beams)
    for seed in options.city:
        settings = load(CityConfig, STAGES / "synthetic.toml", {"seed": seed, "train": 1})
        yield f"city {seed}", City(settings).open("train-000")


def names_fault(findings: list[Finding], case: Case) -> bool:
    """Return whether a warning or fault of that subject says one of the expected words."""
    return any(
        finding.subject == case.subject and finding.level in ("warning", "fault")
        and any(word in finding.sentence for word in case.words)
        for finding in findings
    )  # fmt: skip


def main() -> None:
    """Print a line for each drive and fault, and count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--dataset", default="kitti")
    parser.add_argument("--city", nargs="*", type=int, default=[])
    parser.add_argument("--fewer-beams", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    tally: Counter[str] = Counter()
    for name, drive in drives(options):
        cases: dict[str, Case | None] = {"right": None, **FAULTS}
        for fault, case in cases.items():
            if (
                (options.quick and "compensation" in fault)
                or options.only not in fault
                or (case and case.needs_poses and drive.world_from_ego is None)
            ):
                continue
            part = sample(case.make(drive) if case else drive, quick=options.quick)
            for step in part.steps:
                part.sweep(step)
            start_s = time.process_time()
            findings = list(check_motion(part, CONFIG.motion, is_quick=options.quick))
            spent_s = time.process_time() - start_s
            worst = max(findings, key=lambda finding: LEVELS.index(finding.level))
            is_right = names_fault(findings, case) if case else worst.level in ("ok", "cannot tell")
            tally[f"{'named' if case else 'no false finding'}: {is_right}"] += 1
            print(
                f"{name:22} {fault:22} {worst.level:11} {'yes' if is_right else 'NO ':3} {spent_s:5.1f} s",
                flush=True,
            )
            for finding in findings:
                if finding.level in ("warning", "fault") or not is_right:
                    print(f"    {finding.level}: {finding.sentence}")
    for key, count in sorted(tally.items()):
        print(f"{key}: {count}")


if __name__ == "__main__":
    main()
