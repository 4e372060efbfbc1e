"""The command that checks drives, and the quick check that a run begins with."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from upvl_cli.cli.application import OneSegment, app
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.workspace import Workspace

if TYPE_CHECKING:
    from upvl_cli.commands.drive_check import CheckReport
    from upvl_cli.perception.drive_check.finding import Finding

Anyway = Annotated[
    bool, typer.Option("--anyway", help="Go on with drives in which the quick check finds a fault.")
]
_STYLES = {"ok": "green", "cannot tell": "dim", "warning": "yellow", "fault": "bold red"}


@app.command("check")
def check_drives(
    context: typer.Context,
    segment: OneSegment = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Only what shows within seconds: the part that `autolabel` asks first."),
    ] = False,
    labels: Annotated[
        bool,
        typer.Option(
            "--labels",
            help="Check the human labels of the drives as well; only this and `upvl eval` read them.",
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    anyway: Anyway = False,
) -> None:
    """Measure the sensors of a drive, and look for faults before it is labelled: poses, axes, units, times, pictures.

    No label is read without --labels. The exit code is 2 where a fault was found, and 0 with --anyway.
    """
    from upvl_cli.commands.drive_check import (
        check_segment,
        keep_full_report,
        mark_checked,
        quick_report,
        refuse_faults,
    )

    workspace: Workspace = context.obj
    reports = []
    for name in workspace.segments if segment is None else [segment]:
        workspace.check_name(name, workspace.segments)
        report = quick_report(workspace, name) if quick else check_segment(workspace, name, quick=False)
        if not quick:
            keep_full_report(workspace, report)
        if labels:
            report = replace(report, findings=(*report.findings, *label_findings(workspace, name)))
        reports.append(report)
        if not as_json:
            _print_report(report)
    if as_json:
        print(json.dumps([report.to_json() for report in reports], indent=1, ensure_ascii=False))
    if not anyway:
        refuse_faults(reports)
    if quick:
        for report in reports:
            mark_checked(workspace, report.segment)


def label_findings(workspace: Workspace, segment: str) -> tuple[Finding, ...]:
    """Return the findings on the human labels of a drive."""
    from upvl_cli.commands.check_config import CheckConfig
    from upvl_cli.commands.drive_check import sample_drive
    from upvl_cli.config.toml import load
    from upvl_cli.evaluation.label_check import check_label_source
    from upvl_cli.perception.drive_check.finding import Finding

    config = load(CheckConfig, workspace.stages / "check.toml")
    drive = workspace.drive(segment)
    sample = sample_drive(drive, drive.world_from_ego, config.sample)
    try:
        return tuple(check_label_source(workspace, segment, sample, config.labels))
    except BadInput as error:
        return (Finding("labels", "cannot tell", str(error)),)


def warn_of_labels(workspace: Workspace, segments: Sequence[str] | None) -> None:
    """Print what is wrong with human labels before anything is scored by them."""
    for name in segments or workspace.segments:
        for finding in label_findings(workspace, name):
            if finding.level in ("warning", "fault"):
                print(f"{finding.level}: {name}: {finding.sentence}", file=sys.stderr)


def _print_report(report: CheckReport) -> None:
    if not sys.stdout.isatty():
        print(report.segment)
        for subject, text in report.card.lines if report.card else ():
            print(f"  {subject}: {text}")
        for finding in report.findings:
            print(f"  {finding.level}: {finding.sentence}")
        return
    from rich.console import Console
    from rich.table import Table

    if report.card is not None:
        card = Table(
            "sensor", "measured", title=report.segment, title_justify="left", box=None, pad_edge=False
        )
        for subject, text in report.card.lines:
            card.add_row(subject, text)
        Console().print(card)
    table = Table(title=report.segment, title_justify="left", box=None, pad_edge=False)
    for name in ("", "of", "found", "likely cause", "what to do"):
        table.add_column(name, overflow="fold")
    for finding in report.findings:
        table.add_row(*_cells(finding), style=_STYLES[finding.level])
    Console().print(table)


def _cells(finding: Finding) -> Iterator[str]:
    from rich.markup import escape

    notes = ", ".join(part for part in (finding.where, finding.evidence) if part)
    found = finding.text + (f" ({notes})" if notes else "")
    yield from map(escape, (finding.level, finding.subject, found, finding.cause, finding.remedy))
