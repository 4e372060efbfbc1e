"""The part of a report that says what changed against another run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from upvl_cli.commands.draw import image_from_above
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.errors import NotMade, UpvlError, one_line
from upvl_cli.geometry.camera import project
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.comparison import (
    KEPT_IOU,
    BoxChanges,
    DriveChange,
    change_paints,
    compare_drive,
    other_run,
    read_both,
)
from upvl_cli.report.costs import stage_costs
from upvl_cli.report.drive_labels import DriveLabels, concat_tracks, tracks_of
from upvl_cli.report.pictures import CAMERA_WIDTH_PX, VIEW, EmbeddedPicture, as_picture
from upvl_cli.report.run_summary import MissingPart, RunSummary
from upvl_cli.report.settings import SettingChange, provenance_of, settings_between
from upvl_cli.report.summary_tables import class_changes


@dataclass(frozen=True)
class StageTimes:
    """Seconds of a stage in the other run and in this one; None where the log of runs does not hold them."""

    stage: str
    before: float | None
    after: float | None


@dataclass
class RunChanges:
    """What changed against another run.

    Attributes:
        name: Name of the other run's folder.
        totals: All boxes.
        drives: What changed in each drive that both have, the drive of most changes first.
        classes: Of each class its tracks in the other run and in this one.
        settings: Settings with two values.
        times: Time of each stage.
        versions: Versions with two values.
        stages_of_one: Stages that only one of the runs has made, each with the run that lacks it.
        worst: The frame that changed most; None without a common frame.
        worst_frame: Its number; -1 without one.
        pictures: Pictures of that frame.
        left_out: Drives that only one of the runs has.
        missing: What could not be had.
        kept_iou: 3D IoU from which on a matched box counts as kept.
    """

    name: str
    totals: BoxChanges
    drives: list[DriveChange]
    classes: list[tuple[str, int, int]]
    settings: tuple[SettingChange, ...]
    times: list[StageTimes]
    versions: tuple[SettingChange, ...]
    stages_of_one: list[tuple[str, str]]
    worst: DriveChange | None
    worst_frame: int
    pictures: list[EmbeddedPicture]
    left_out: int
    missing: list[MissingPart] = field(default_factory=list)
    kept_iou: float = KEPT_IOU


def gather_changes(
    workspace: Workspace, against: Path, drives: Sequence[DriveLabels], summary: RunSummary
) -> RunChanges:
    """Return what changed against another run.

    Args:
        workspace: The workspace of this run.
        against: Folder of the other run's results.
        drives: Labels of this run.
        summary: What the report of this run holds.

    Raises:
        BadSetting: The folder is missing, or has labels of none of the drives.
        NotMade: Its labels are damaged.
    """
    other, common = other_run(workspace, against, [labels.segment for labels in drives])
    pairs = [
        (before, labels)
        for labels in drives
        if labels.segment in set(common) and (before := read_both(other, labels)) is not None
    ]
    if not pairs:
        raise NotMade(f"--against {against}: its labels are damaged; delete them and make them again")
    changed = [compare_drive(before, after) for before, after in pairs]
    worst = max(
        (change for change in changed if change.worst_place >= 0), key=lambda c: c.worst.total, default=None
    )
    provenance = provenance_of(other, common)
    costs = {cost.stage: cost.seconds for cost in stage_costs(other, common)}
    own = {cost.stage: cost.seconds for cost in stage_costs(workspace, common)}
    found = RunChanges(
        name=against.name or str(against),
        totals=sum((change.changes for change in changed), BoxChanges()),
        drives=sorted(changed, key=lambda change: -change.changes.total),
        classes=class_changes(
            concat_tracks([tracks_of(before) for before, _ in pairs]),
            concat_tracks([tracks_of(after) for _, after in pairs]),
        ),
        settings=settings_between(provenance.values, summary.provenance.values),
        times=[
            StageTimes(stage, costs.get(stage), own.get(stage)) for stage in dict.fromkeys([*own, *costs])
        ],
        versions=settings_between(provenance.versions, summary.provenance.versions),
        worst=worst,
        stages_of_one=[
            *((stage, against.name) for stage in own if stage not in costs),
            *((stage, "this run") for stage in costs if stage not in own),
        ],
        worst_frame=-1,
        pictures=[],
        left_out=len(drives) - len(pairs),
    )
    if worst is not None and worst.worst.total:
        before, after = next(pair for pair in pairs if pair[1].segment == worst.segment)
        _draw_worst(workspace, before, after, worst, found)
    return found


def _draw_worst(
    workspace: Workspace, before: DriveLabels, after: DriveLabels, worst: DriveChange, found: RunChanges
) -> None:
    """Draw the frame that changed most: from above, and by the camera that sees most boxes."""
    boxes, paints = change_paints(before, after, worst.worst_place)
    frame = found.worst_frame = after.frames[worst.worst_place]
    counts = worst.worst
    text = f"{counts.kept} boxes kept, {counts.moved} moved, {counts.new} new, {counts.lost} lost"
    try:
        image = image_from_above(
            workspace, after.segment, frame, boxes, view=VIEW, paints=paints, has_tails=False
        )
        found.pictures.append(
            as_picture(
                image, f"Bird's-eye view of frame {frame} of {after.segment}: {text}", "Bird's-eye view"
            )
        )
        drive = workspace.drive(after.segment)
        cameras = sorted(drive.cameras, key=lambda camera: -int(project(camera, boxes.center_m)[2].sum()))
        for camera in cameras[:1]:
            picture = drive.image(frame, camera.name)
            if picture is not None:
                view = camera_view(picture.rgb, camera, boxes, paints, CAMERA_WIDTH_PX)
                alt = f"Camera {camera.name}, frame {frame} of {after.segment}: {text}"
                found.pictures.append(as_picture(view, alt, f"Camera {camera.name}"))
    except UpvlError as error:
        found.missing.append(
            MissingPart("pictures of the change", one_line(error), f"upvl draw {after.segment}")
        )
