"""Gathers what the contact sheet of a query shows, from the drives; what is not there is left out."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.drawing.hit_sheet import Shot, part_with_box, sheet, tile
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.find import Hits
from upvl_cli.query.question import Question
from upvl_cli.query.report import best_of_tracks
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, TrackedBoxes

if TYPE_CHECKING:
    from PIL.Image import Image

MOST = 20  # hits that are drawn


def draw(workspace: Workspace, hits: Hits, question: Question, path: Path) -> Path:
    """Draw the best box of each of the best tracks; returns the path.

    Args:
        workspace: Whose drives.
        hits: At least one, best first.
        question: What was asked.
        path: Where the picture goes.
    """
    chosen = best_of_tracks(hits)[0][:MOST]
    order = chosen[np.argsort(hits.segment[chosen], kind="stable")]  # a drive is opened once
    tiles = {int(place): _tile(workspace, hits[place : place + 1], question) for place in order}
    image = sheet([tiles[int(place)] for place in chosen])
    with atomic_file(path) as file:
        image.save(file, format="PNG", compress_level=1)
    return path


def _tile(workspace: Workspace, hit: Hits, question: Question) -> Image:
    segment, frame = str(hit.segment[0]), int(hit.frame[0])
    box = TrackedBoxes.from_rows(
        hit.seven, velocity_mps=hit.velocity_mps, score=hit.score, track_id=hit.track_id
    )
    title = (
        f"{question.names[hit.kind[0]]} {hit.score[0]:.2f}  {segment} frame {frame}  {hit.time_s[0]:.1f} s"
    )
    return tile(_points(workspace, segment, frame), box, _shot(workspace, segment, frame, box), title)


def _points(workspace: Workspace, segment: str, frame: int) -> Array:
    with suppress(UpvlError):
        return workspace.drive(segment).points(frame).xyz_ego_m
    return np.zeros((0, 3))


def _shot(workspace: Workspace, segment: str, frame: int, box: TrackedBoxes) -> Shot | None:
    """The largest view of the box."""
    with suppress(UpvlError):
        drive = workspace.drive(segment)
        seen = [(camera, part_with_box(camera, box)) for camera in drive.cameras]
        views = [(camera, part) for camera, part in seen if part is not None]
        for camera, part in sorted(views, key=lambda view: -_area(view[1])):
            image = drive.image(frame, camera.name)
            if image is not None:
                return Shot(image.rgb, camera, part)
    return None


def _area(part: tuple[float, float, float, float]) -> float:
    left, top, right, bottom = part
    return (right - left) * (bottom - top)
