"""What a report holds, gathered from the shards of a workspace; numbers that cannot be had are named with a command."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from upvl_cli.commands.drive_check import FullCheck, kept_full_report, kept_report
from upvl_cli.commands.verdict import verdict
from upvl_cli.errors import NotMade, UpvlError, one_line
from upvl_cli.perception.drive_check.finding import LEVELS
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.costs import StageCost, StageCounts, stage_costs, stage_counts
from upvl_cli.report.drive_labels import DriveLabels, TrackTable, concat_tracks, read_labels, tracks_of
from upvl_cli.report.figures import Histogram, Ranking
from upvl_cli.report.pictures import EmbeddedFrame, PictureBudget, frame_pictures
from upvl_cli.report.scores import ScoreSheet, score_sheets
from upvl_cli.report.settings import Provenance, SettingChange, changed_settings, provenance_of
from upvl_cli.report.summary_tables import ClassCounts, FoundTotals, class_counts, distributions, travel_m
from upvl_cli.report.track_map import TrackMap, track_map
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Array

# Of the 10 megabytes that a report may have. What remains holds texts and tables.
PICTURE_BYTES, MAP_BYTES = 5_500_000, 1_800_000
MIN_MAP_BYTES = 6_000  # a map with less shows too few tracks
MOST_DRIVES = 1000  # rows of the table of drives, some 400 bytes each
MOST_FINDINGS = 300
MOST_CARDS = 20
MOST_STALE = 200  # drives that are asked whether their labels are stale


@dataclass(frozen=True)
class MissingPart:
    """A part that could not be had: what it is, why, and the command that makes it; empty for none."""

    what: str
    reason: str
    command: str = ""


@dataclass(frozen=True)
class CheckSummary:
    """What the check of a drive found: whether it was the full one, its findings, and the sensor card."""

    segment: str
    is_full: bool
    check: FullCheck


@dataclass(frozen=True)
class DriveReport:
    """One drive: its counts, its map and its pictures."""

    segment: str
    frames: int
    duration_s: float
    travel_m: float | None
    boxes: int
    tracks: int
    moving_tracks: int
    digest: str
    map: TrackMap | None
    pictures: tuple[EmbeddedFrame, ...]


@dataclass
class RunSummary:
    """All that the page shows but what changed."""

    suspicions: list[str]
    verdict: str
    totals: FoundTotals
    classes: list[ClassCounts]
    rankings: list[Ranking]
    histograms: list[Histogram]
    drives: list[DriveReport]
    drives_left_out: int
    checks: list[CheckSummary]
    findings_left_out: int
    scores: list[ScoreSheet]
    costs: list[StageCost]
    counts: list[StageCounts]
    provenance: Provenance
    settings: tuple[SettingChange, ...]
    presets: list[str]
    missing: list[MissingPart] = field(default_factory=list)


def labelled_drives(workspace: Workspace, segments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the drives to report on, and those of the workspace that have no labels.

    Args:
        workspace: The workspace; where its drives cannot be read any more, its shards name them.
        segments: Names of the drives; empty takes all that have labels.

    Raises:
        BadSetting: There is no such drive.
        NotMade: None of them has been labelled, or one of those that are named has not.
    """
    try:
        known = workspace.segments
    except UpvlError:
        known = tuple(sorted(path.stem for path in (workspace.out / "labels").glob("*.parquet")))
        if not known:
            raise
    for name in segments:
        workspace.check_name(name, known)
    has_labels = {name: workspace.shard("labels", name).exists() for name in segments or known}
    without = [name for name, has in has_labels.items() if not has]
    if segments and without:
        raise NotMade(f"{without[0]} has not been labelled; run: upvl autolabel --all-motion -s {without[0]}")
    if not any(has_labels.values()):
        raise NotMade(f"{workspace.out / 'labels'} has no file; run: upvl autolabel --all-motion")
    return [name for name in has_labels if has_labels[name]], without


def gather_summary(
    workspace: Workspace, drives: Sequence[DriveLabels], unlabelled: Sequence[str]
) -> RunSummary:
    """Return all that the page shows but what changed.

    Args:
        workspace: The workspace of the labels.
        drives: Labels of each drive.
        unlabelled: Names of drives without labels, which are named as missing.
    """
    names = [labels.segment for labels in drives]
    tables = [tracks_of(labels) for labels in drives]
    tracks = concat_tracks(tables)
    missing = [MissingPart(f"labels of {name}", "it is not labelled", f"upvl autolabel --all-motion -s {name}")
               for name in unlabelled[:20]]  # fmt: skip
    suspicions, result = _verdict(workspace, names, missing)
    suspicions = [*_stale(workspace, names), *suspicions]
    rankings, histograms = distributions(drives, tracks)
    provenance = provenance_of(workspace, names)
    reports = _drive_reports(workspace, drives, tables, provenance, missing)
    checks, findings_left_out = _checks(workspace, names, missing)
    scores = list(score_sheets(workspace, names))
    if not scores:
        missing.append(MissingPart("scores", "nothing was compared with human labels", "upvl eval"))
    costs = list(stage_costs(workspace, names))
    if unknown := [cost.stage for cost in costs if cost.seconds is None]:
        reason = f"out/runs.jsonl does not hold the runs of {', '.join(unknown)}"
        missing.append(
            MissingPart("time and memory", reason, "upvl autolabel --all-motion, into an empty folder")
        )
    return RunSummary(
        suspicions=suspicions,
        verdict=result,
        totals=_totals(workspace, drives, tracks, reports, missing),
        classes=list(class_counts(drives, tracks)),
        rankings=rankings,
        histograms=histograms,
        drives=reports[:MOST_DRIVES],
        drives_left_out=max(len(reports) - MOST_DRIVES, 0),
        checks=checks,
        findings_left_out=findings_left_out,
        scores=scores,
        costs=costs,
        counts=list(stage_counts(workspace, names)),
        provenance=provenance,
        settings=changed_settings(workspace, provenance.values),
        presets=workspace.presets,
        missing=missing,
    )


def _verdict(workspace: Workspace, names: Sequence[str], missing: list[MissingPart]) -> tuple[list[str], str]:
    try:
        *suspicions, result = verdict(workspace, names)
    except UpvlError as error:
        missing.append(MissingPart("verdict", one_line(error), "upvl summary"))
        return [], ""
    return suspicions, result.removeprefix("verdict: ")


def _stale(workspace: Workspace, names: Sequence[str]) -> Iterator[str]:
    """Yield the drives whose labels do not follow from the present settings and files."""
    stage = workspace.pipeline.by_name["labels"]
    for name in names[:MOST_STALE]:
        with contextlib.suppress(UpvlError):  # the settings or the drive are gone, which the verdict tells
            condition, reason = state(workspace, stage, name)
            if condition == "stale":
                yield f"stale: {name}: its labels were made with something else ({reason}); run: upvl autolabel"


def _totals(
    workspace: Workspace,
    drives: Sequence[DriveLabels],
    tracks: TrackTable,
    reports: Sequence[DriveReport],
    missing: list[MissingPart],
) -> FoundTotals:
    footers = [read_footer(workspace.shard("detect", labels.segment)) for labels in drives]
    found = [sum(rows for _, rows, _ in footer.frames) for footer in footers if footer]
    if not found:
        missing.append(
            MissingPart("boxes of the detector", "none were made", "upvl train, then: upvl detect")
        )
    travelled = [report.travel_m for report in reports if report.travel_m is not None]
    return FoundTotals(
        drives=len(drives),
        frames=sum(len(labels.frames) for labels in drives),
        duration_s=sum(labels.duration_s for labels in drives),
        travel_m=sum(travelled) if travelled else None,
        boxes=sum(len(labels.boxes) for labels in drives),
        moving_boxes=sum(int(labels.is_moving.sum()) for labels in drives),
        tracks=len(tracks),
        moving_tracks=int(tracks.is_moving.sum()),
        detections=sum(found) if found else None,
    )


def _drive_reports(
    workspace: Workspace,
    drives: Sequence[DriveLabels],
    tables: Sequence[TrackTable],
    provenance: Provenance,
    missing: list[MissingPart],
) -> list[DriveReport]:
    map_bytes = max(MAP_BYTES / len(drives), MIN_MAP_BYTES)
    most_maps = int(MAP_BYTES / map_bytes)
    budget = PictureBudget(PICTURE_BYTES)
    pictures: dict[str, list[EmbeddedFrame]] = {}
    for found in frame_pictures(workspace, drives, budget):
        pictures.setdefault(found.segment, []).append(found)
        if found.fault:
            missing.append(
                MissingPart(f"pictures of {found.segment}", found.fault, "upvl draw " + found.segment)
            )
    reports = []
    for number, (labels, tracks) in enumerate(zip(drives, tables, strict=True)):
        poses = _poses(workspace, labels, missing)
        shown = [found for found in pictures.get(labels.segment, []) if found.pictures]
        has_map = poses is not None and number < most_maps
        reports.append(
            DriveReport(
                segment=labels.segment,
                frames=len(labels.frames),
                duration_s=labels.duration_s,
                travel_m=None if poses is None else travel_m(poses),
                boxes=len(labels.boxes),
                tracks=len(tracks),
                moving_tracks=int(tracks.is_moving.sum()),
                digest=provenance.digests.get(labels.segment, ""),
                map=track_map(labels, tracks, poses, map_bytes) if poses is not None and has_map else None,
                pictures=tuple(sorted(shown, key=lambda found: found.frame)),
            )
        )
    _note_left_out(reports, most_maps, missing)
    return reports


def _note_left_out(reports: Sequence[DriveReport], most_maps: int, missing: list[MissingPart]) -> None:
    """Name what had no room in the page."""
    faulty = {part.what.removeprefix("pictures of ") for part in missing}
    bare = [report.segment for report in reports if not report.pictures and report.segment not in faulty]
    one_drive = "upvl report -s NAME"
    if bare:
        reason = f"the page of 10 MB has no room for pictures of {len(bare)} of {len(reports)} drives"
        missing.append(MissingPart("pictures", reason, one_drive))
    if len(reports) > most_maps:
        reason = f"the page of 10 MB has no room for {len(reports) - most_maps} of {len(reports)} maps"
        missing.append(MissingPart("maps", reason, one_drive))


def _poses(workspace: Workspace, labels: DriveLabels, missing: list[MissingPart]) -> Array | None:
    """Return (T, 4, 4) the pose of each frame of the labels; None where odometry was not made of the same frames."""
    try:
        table = workspace.table("odometry", OdometryRow, labels.segment)
        rows = {row.frame: row.world_from_ego for row in table}
        return np.array([rows[frame] for frame in labels.frames]).reshape(-1, 4, 4)
    except (NotMade, KeyError) as error:
        reason = one_line(error) if isinstance(error, NotMade) else "odometry was made of other frames"
        missing.append(MissingPart(f"map of {labels.segment}", reason, "upvl odometry"))
        return None


def _checks(
    workspace: Workspace, names: Sequence[str], missing: list[MissingPart]
) -> tuple[list[CheckSummary], int]:
    """Return what the checks of the drives found, the worst first, and how many findings the page has no room for."""
    checks, without_card, unchecked, left_out = [], [], [], 0
    for name in names:
        try:
            full, quick = kept_full_report(workspace, name), kept_report(workspace, name)
        except UpvlError as error:  # its settings or its drive are gone
            missing.append(MissingPart(f"check of {name}", one_line(error), f"upvl check {name}"))
            continue
        if full is None or not full.card:
            without_card.append(name)
        if full is None and quick is None:
            unchecked.append(name)
            continue
        checks.append(
            CheckSummary(name, full is not None, full or FullCheck(quick.findings if quick else (), ()))
        )
    if unchecked:
        reason = "they were not checked with the present settings"
        missing.append(MissingPart(f"check of {_few(unchecked)}", reason, f"upvl check {unchecked[0]}"))
    if without_card:
        reason = "sensors are measured by the full check"
        missing.append(
            MissingPart(f"sensor card of {_few(without_card)}", reason, f"upvl check {without_card[0]}")
        )
    checks.sort(
        key=lambda item: -max((LEVELS.index(found.level) for found in item.check.findings), default=0)
    )
    shown, room = [], MOST_FINDINGS
    for number, item in enumerate(checks):
        findings = item.check.findings[: max(room, 0)]
        room -= len(findings)
        left_out += len(item.check.findings) - len(findings)
        card = item.check.card if number < MOST_CARDS else ()
        shown.append(CheckSummary(item.segment, item.is_full, FullCheck(findings, card)))
    return [item for item in shown if item.check.findings], left_out


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more drives" if len(names) > 3 else "")


def read_drives(workspace: Workspace, names: Sequence[str]) -> list[DriveLabels]:
    """Return the labels of some drives.

    Raises:
        NotMade: The labels of one are damaged.
    """
    return [read_labels(workspace, name) for name in names]
