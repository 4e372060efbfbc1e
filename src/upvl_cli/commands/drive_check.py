"""What is wrong with a drive before anything is computed on it, without any label."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from upvl_cli.commands.check_config import CheckConfig, SampleConfig
from upvl_cli.config.toml import load
from upvl_cli.errors import UpvlError
from upvl_cli.perception.drive_check.clock_check import check_clock
from upvl_cli.perception.drive_check.completeness import check_completeness
from upvl_cli.perception.drive_check.finding import LEVELS, Finding, Level
from upvl_cli.perception.drive_check.motion_check import check_motion
from upvl_cli.perception.drive_check.pictures import check_pictures
from upvl_cli.perception.drive_check.points_check import check_own_car, check_points
from upvl_cli.perception.drive_check.pose_check import REFINED
from upvl_cli.perception.drive_check.sample import DriveSample, spread_runs
from upvl_cli.perception.drive_check.units_check import check_units
from upvl_cli.perception.sensor.card import SensorCard
from upvl_cli.perception.sensor.limits import limits
from upvl_cli.pipeline.provenance import to_json
from upvl_cli.pipeline.tables import Table
from upvl_cli.runtime.atomic import write_if_changed
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import OdometryRow

if TYPE_CHECKING:
    from pathlib import Path

    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Array, Drive, Image

_VERSION = 1  # raised by hand when a check finds other things on equal drives
_SWEEPS_AT_HAND, _PICTURES_AT_HAND = 48, 64  # a sweep holds some 5 MB, a picture 1.5 MB


@dataclass(frozen=True)
class CheckReport:
    """All findings on one drive.

    Attributes:
        segment: Name of the drive.
        findings: In the order of the checks.
        card: Its sensors; None where they were not measured.
    """

    segment: str
    findings: tuple[Finding, ...]
    card: SensorCard | None = None

    @property
    def faults(self) -> tuple[Finding, ...]:
        """What makes labels wrong."""
        return tuple(finding for finding in self.findings if finding.is_fault)

    @property
    def level(self) -> Level:
        """The worst level of all."""
        return max((finding.level for finding in self.findings), key=LEVELS.index, default="ok")

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        card = {} if self.card is None else {"sensors": self.card.to_json()}
        found = [finding.to_json() for finding in self.findings]
        return {"segment": self.segment, "level": self.level, "findings": found, **card}


def check_segment(workspace: Workspace, segment: str, *, quick: bool) -> CheckReport:
    """Check one drive.

    Args:
        workspace: Names the dataset, and holds check.toml; the cameras of a drive without poses are checked with those
            of `odometry`, where they were made.
        segment: Name of the drive.
        quick: Whether to look only at what shows in seconds.

    Raises:
        BadInput: The drive cannot be read.
    """
    config = load(CheckConfig, workspace.stages / "check.toml")
    drive = workspace.drive(segment)
    use = _use_of_poses(workspace)
    poses = None if use == "estimated" else drive.world_from_ego
    if quick:
        found = tuple(_quick_findings(sample_drive(drive, poses, config.quick), config))
        report = CheckReport(segment, found)
    else:
        report = check_drive(drive, poses, _best_poses(workspace, segment), config)
    if use != "refined":
        return report
    return replace(report, findings=tuple(map(_as_refined, report.findings)))


def _use_of_poses(workspace: Workspace) -> str:
    """Return what odometry does with the poses of a drive: given, estimated or refined."""
    stage = workspace.pipeline.by_name["odometry"]
    return str(workspace.settings(stage).values()["poses"])


def _as_refined(finding: Finding) -> Finding:
    """Return a finding that refinement of the poses mends as one that is mended."""
    if REFINED not in finding.remedy:
        return finding
    return replace(finding, level="ok", remedy="odometry refines them")


def check_drive(
    drive: Drive, poses: Array | None, best_poses: Array | None, config: CheckConfig
) -> CheckReport:
    """Check all of a drive.

    Args:
        drive: The drive.
        poses: (T, 4, 4) the poses to check; None where they are not used.
        best_poses: (T, 4, 4) the best known poses of its frames, by which pictures and sweeps are brought together.
        config: Settings.
    """
    # Both load much that the quick part does without.
    from upvl_cli.perception.drive_check.cameras import check_cameras
    from upvl_cli.perception.sensor.measure import measure_sensor

    sample = sample_drive(drive, poses, config.sample)
    found = list(_sweep_findings(sample, config, is_quick=False))
    if _has_fault(found, "clock", "points"):
        return CheckReport(drive.name, tuple(found))
    card = measure_sensor(sample, config.sensor)
    found += _from_card(card, config)
    if not drive.cameras:
        found.append(Finding("sensor", "ok", "the drive has no camera"))
    if not _has_fault(found, "units", "axes", "poses"):  # cameras would be blamed for it
        found += check_cameras(replace(sample, world_from_ego=best_poses), config.camera)
    return CheckReport(drive.name, tuple(found), card)


def _best_poses(workspace: Workspace, segment: str) -> Array | None:
    """Return the poses of a drive, or those that `odometry` made of it; None where there are neither."""
    drive = workspace.drive(segment)
    path = workspace.shard("odometry", segment)
    if drive.world_from_ego is not None or not path.is_file():
        return drive.world_from_ego
    table = Table(path, OdometryRow)
    is_same = table.frames == tuple(frame.index for frame in drive.frames)
    return np.array([row.world_from_ego for row in table]) if is_same else None


def _quick_findings(sample: DriveSample, config: CheckConfig) -> Iterator[Finding]:
    yield from _sweep_findings(sample, config, is_quick=True)
    places = np.linspace(0, len(sample.runs) - 1, min(config.quick.pictures, len(sample.runs))).round()
    steps = [sample.runs[int(place)][0] for place in places]
    for camera, pictures in zip(sample.cameras, _pictures(sample, steps), strict=True):
        yield from check_pictures(sample, camera, pictures, config.camera.picture)


def _pictures(sample: DriveSample, steps: Sequence[int]) -> Iterator[dict[int, Image | None]]:
    """Yield the pictures of each camera, by step; read by as many threads as there are cores."""
    asked = [(step, camera.name) for camera in sample.cameras for step in steps]
    images = in_order(lambda pair: sample.picture(*pair), asked)
    for _ in sample.cameras:
        yield {step: next(images) for step in steps}


def _sweep_findings(sample: DriveSample, config: CheckConfig, *, is_quick: bool) -> Iterator[Finding]:
    """Yield what is found without a picture; what would only repeat a fault is not asked."""
    found = [
        *check_completeness(sample),
        *check_clock(sample, config.clock),
        *check_points(sample, config.points),
    ]
    yield from found
    # Points of other numbers, or times in disorder, have neither a unit nor a motion.
    if not _has_fault(found, "clock", "points"):
        yield from check_units(sample, config.units)
        yield from check_motion(sample, config.motion, is_quick=is_quick)


def _has_fault(findings: Sequence[Finding], *subjects: str) -> bool:
    return any(finding.is_fault and finding.subject in subjects for finding in findings)


def _from_card(card: SensorCard, config: CheckConfig) -> Iterator[Finding]:
    """Yield what the sensors see of the car itself, and what they cannot give."""
    yield from check_own_car(card)
    for sentence in limits(card, config.sensor):
        yield Finding("sensor", "ok", sentence)


def sample_drive(drive: Drive, poses: Array | None, config: SampleConfig) -> DriveSample:
    """Return a sample of a drive; sweeps and pictures are read when they are asked for."""
    frames = drive.frames
    points, image = lru_cache(_SWEEPS_AT_HAND)(drive.points), lru_cache(_PICTURES_AT_HAND)(drive.image)
    return DriveSample(
        frames=frames,
        world_from_ego=poses,
        ground_z_m=drive.ground_z_m,
        cameras=drive.cameras,
        runs=spread_runs(len(frames), config.runs, config.sweeps),
        sweep=lambda step: points(frames[step].index),
        picture=lambda step, camera: image(frames[step].index, camera),
        skipped=drive.skipped,
    )


def quick_report(workspace: Workspace, segment: str) -> CheckReport:
    """Return the quick check of a drive, from `out/check` where the drive and the settings are the same."""
    kept = kept_report(workspace, segment)
    if kept is not None:
        return kept
    report = check_segment(workspace, segment, quick=True)
    content = {"stamp": _stamp(workspace, segment), **report.to_json()}
    text = json.dumps(content, indent=1, ensure_ascii=False)
    write_if_changed(_report_path(workspace, segment), text + "\n")
    return report


def kept_report(workspace: Workspace, segment: str) -> CheckReport | None:
    """Return the last quick check of a drive; None where it was not asked, or the drive is another one since."""
    return _kept(_report_path(workspace, segment), _stamp(workspace, segment), segment)


@dataclass(frozen=True)
class FullCheck:
    """What the full check of a drive found when it was last asked.

    Attributes:
        findings: In the order of the checks.
        card: Its sensor card for people: subject and text of each line; empty where they were not measured.
    """

    findings: tuple[Finding, ...]
    card: tuple[tuple[str, str], ...]


def keep_full_report(workspace: Workspace, report: CheckReport) -> None:
    """Write the full check of a drive to `out/check/full`, for those who show it later."""
    content = {
        "stamp": _stamp(workspace, report.segment),
        "findings": [finding.to_json() for finding in report.findings],
        "card": report.card.lines if report.card else (),
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    write_if_changed(_full_path(workspace, report.segment), text + "\n")


def kept_full_report(workspace: Workspace, segment: str) -> FullCheck | None:
    """Return the last full check of a drive; None where it was not asked, or the drive is another one since."""
    path, stamp = _full_path(workspace, segment), _stamp(workspace, segment)
    report = _kept(path, stamp, segment)
    if report is None:
        return None
    try:
        lines = json.loads(path.read_text(encoding="utf-8"))["card"]
        return FullCheck(report.findings, tuple((str(subject), str(text)) for subject, text in lines))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _full_path(workspace: Workspace, segment: str) -> Path:
    return workspace.out / "check" / "full" / f"{segment}.json"


def _report_path(workspace: Workspace, segment: str) -> Path:
    return workspace.out / "check" / f"{segment}.json"


def mark_checked(workspace: Workspace, segment: str) -> None:
    """Write the mark by which make knows that a drive may be labelled."""
    write_if_changed(workspace.out / "check" / f"{segment}.ok", _stamp(workspace, segment))


def _stamp(workspace: Workspace, segment: str) -> str:
    settings = load(CheckConfig, workspace.stages / "check.toml").values()
    makers = {"version": _VERSION, "poses": _use_of_poses(workspace), "raw": workspace.raw_stamp(segment)}
    return to_json(makers | {"values": settings})


def _kept(path: Path, stamp: str, segment: str) -> CheckReport | None:
    """Return the report in a file, or None where it is another drive's or damaged."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["stamp"] != stamp:
            return None
        return CheckReport(segment, tuple(Finding(**values) for values in kept["findings"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


class FaultyDrive(UpvlError):
    """A drive whose labels would be wrong."""


def refuse_faults(reports: Sequence[CheckReport]) -> None:
    """Stop a run over drives that have faults.

    Raises:
        FaultyDrive: Some drive has a fault; the message names the first, and how to go on.
    """
    faulty = [report for report in reports if report.faults]
    if not faulty:
        return
    first = faulty[0]
    others = f"; {len(faulty) - 1} more drives have faults" if len(faulty) > 1 else ""
    more = f" (and {len(first.faults) - 1} more)" if len(first.faults) > 1 else ""
    raise FaultyDrive(
        f"{first.segment}: {first.faults[0].sentence}{more}{others}; see: upvl check {first.segment}; to go on "
        "all the same: --anyway"
    )
