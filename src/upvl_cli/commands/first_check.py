"""The quick check of a drive, which is asked before anything is made of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.commands.drive_check import quick_report, refuse_faults
from upvl_cli.config.toml import load
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.executors.base import FirstCheck
from upvl_cli.pipeline.workspace import Workspace


def first_check(workspace: Workspace, *, anyway: bool) -> FirstCheck:
    """Return what is to be asked of each drive of a run.

    Args:
        workspace: The workspace of the drives.
        anyway: Whether a drive with a fault is gone on with.

    Raises:
        BadSetting: The settings of the check are wrong: told once, and not for each drive.
    """
    load(CheckConfig, workspace.stages / "check.toml")
    return partial(_check, anyway=anyway)


def _check(workspace: Workspace, segment: str, *, anyway: bool) -> Iterator[str]:
    """Yield what is suspicious in a drive, a line each.

    Raises:
        FaultyDrive: The drive has a fault; raised after its lines.
    """
    try:
        report = quick_report(workspace, segment)
    except BadInput:  # a drive that cannot be read is told by the first stage
        return
    for finding in report.findings:
        if finding.level in ("warning", "fault"):
            yield f"{finding.level}: {segment}: {finding.sentence}"
    if not anyway:
        refuse_faults([report])
