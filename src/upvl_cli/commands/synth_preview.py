"""Draws frames of the made-up drives with what is true of them."""

from __future__ import annotations

from pathlib import Path

from upvl_cli.drawing.contact_sheet import LabelledPicture, contact_sheet
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.synthetic.cameras import CAMERAS
from upvl_cli.synthetic.dataset import City


def preview(workspace: Workspace, segment: str, frame: int | None) -> Path:
    """Draw the contact sheet of one frame; returns its file.

    Args:
        workspace: Where.
        segment: Which made-up drive.
        frame: Index of the frame; None takes the middle one.

    Raises:
        BadSetting: The workspace has other drives than made-up ones, or the drive has no such frame.
    """
    dataset = workspace.dataset
    if not isinstance(dataset, City):
        raise BadSetting(
            f"stages/raw.toml names dataset {workspace.raw.dataset!r}; only the drives of 'synthetic' are made up"
        )
    workspace.check_name(segment, workspace.segments)
    drive = dataset.open(segment)
    last = len(drive.frames) - 1
    chosen = (last + 1) // 2 if frame is None else frame
    if not 0 <= chosen <= last:
        raise BadSetting(f"{segment} has no frame {chosen}: it has 0 to {last}")
    from_left = sorted(CAMERAS, key=lambda camera: -int(camera.ego_from_camera[1, 3] * 1000))
    shots = []
    for camera in from_left:
        image, truth = drive.image_with_truth(chosen, camera.name)
        shots.append(LabelledPicture(image.rgb, truth.name))
    points, known = drive.points_with_truth(chosen)
    title = f"{segment}  frame {chosen}  {len(points):,} points  {len(drive.scene.things)} things"
    sheet = contact_sheet(shots, points.xyz_ego_m, known.name, drive.scene.names, title)
    path = workspace.out / "draw" / f"{segment}-{chosen:06d}-preview.png"
    with atomic_file(path) as file:
        sheet.save(file, format="PNG")
    return path
