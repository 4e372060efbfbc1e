"""What is known of a drive, in words: its labels, what is suspicious of them, what the check found, its sensors."""

from __future__ import annotations

from collections.abc import Iterator

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.commands.drive_check import kept_report, sample_drive
from upvl_cli.commands.summary import lines
from upvl_cli.commands.verdict import verdict
from upvl_cli.config.toml import load
from upvl_cli.errors import BadInput, NotMade
from upvl_cli.perception.sensor.limits import limits
from upvl_cli.perception.sensor.measure import measure_sensor
from upvl_cli.pipeline.workspace import Workspace


def summary_markdown(workspace: Workspace, segment: str) -> str:
    """Return what was found in a drive, what of it is suspicious, and what the check said; empty for none of them.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
    """
    parts = [*_labels_part(workspace, segment), *_check_part(workspace, segment)]
    return "\n\n".join([f"# {segment}", *parts]) if parts else ""


def _labels_part(workspace: Workspace, segment: str) -> Iterator[str]:
    try:
        first, *stages = lines(workspace, [segment])
        yield first.partition(": ")[2]
        if workspace.shard("labels", segment).exists():
            yield from verdict(workspace, [segment])
    except (NotMade, BadInput):  # no labels, or a drive that cannot be read any more
        return
    yield "## What each stage kept and dropped"
    yield "\n".join(f"- {line.strip()}" for line in stages)


def _check_part(workspace: Workspace, segment: str) -> Iterator[str]:
    try:
        report = kept_report(workspace, segment)
    except BadInput:
        return
    if report is not None:
        yield "## Quick check of the drive"
        found = report.findings
        yield "\n".join(f"- {finding.level}: {finding.sentence}" for finding in found) or "nothing found"


def sensor_markdown(workspace: Workspace, segment: str) -> str:
    """Return the card of the sensors of a drive, which is measured now; empty where the drive cannot be read.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
    """
    config = load(CheckConfig, workspace.stages / "check.toml")
    try:
        drive = workspace.drive(segment)
        card = measure_sensor(sample_drive(drive, drive.world_from_ego, config.sample), config.sensor)
    except BadInput:
        return ""
    rows = [f"| {subject} | {text} |" for subject, text in card.lines]
    notes = [f"- {sentence}" for sentence in limits(card, config.sensor)]
    return "\n".join(
        [f"# Sensors of {segment}", "", "| sensor | measured |", "| --- | --- |", *rows, "", *notes]
    )
