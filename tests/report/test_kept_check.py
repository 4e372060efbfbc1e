"""The full check of a drive is kept for the report, until the drive or the settings change."""

from __future__ import annotations

from pathlib import Path

from command import set_value
from report.made_up_run import SEGMENT, made_up_run
from report.test_report_page import read
from upvl_cli.commands.drive_check import (
    CheckReport,
    FullCheck,
    keep_full_report,
    kept_full_report,
)
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.sensor.card import SensorCard
from upvl_cli.report.run import write_report

FINDING = Finding(
    "poses", "warning", "the poses jump", where="frames 3 to 5", cause="<b>GPS</b>", remedy="use odometry"
)
CARD = SensorCard(6, 10.0, 0.01, 0.1, 0.0, None, True, (), ())


def test_kept_check_comes_back_and_is_shown(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    assert kept_full_report(workspace, SEGMENT) is None
    keep_full_report(workspace, CheckReport(SEGMENT, (FINDING,), CARD))
    assert kept_full_report(workspace, SEGMENT) == FullCheck((FINDING,), CARD.lines)
    text = read(write_report(workspace, (), tmp_path / "page.html").path).text
    assert "full check" in text
    assert "warning poses the poses jump (frames 3 to 5) <b>GPS</b>; use odometry" in text
    assert "sweeps 6 frames, 10.00 Hz, jitter 1.0%, points over 100 ms" in text
    assert "sensors are measured by the full check" not in text


def test_check_made_with_other_settings_or_damaged_is_not_shown(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    keep_full_report(workspace, CheckReport(SEGMENT, (FINDING,), None))
    assert kept_full_report(workspace, SEGMENT) == FullCheck((FINDING,), ())
    set_value(tmp_path, "check", "clear_sigmas", "9.0")
    assert kept_full_report(made_up_run(tmp_path), SEGMENT) is None
    path = workspace.out / "check" / "full" / f"{SEGMENT}.json"
    path.write_text(path.read_text()[:-40])
    assert kept_full_report(workspace, SEGMENT) is None
