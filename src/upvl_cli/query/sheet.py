"""The contact sheet of a query: points and picture of the best hits; what a drive does not have is left out."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.drawing.hit_sheet import HitPicture, part_with_box, sheet, tile
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.query.find import Hits
from upvl_cli.query.report import best_of_tracks
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, TrackedBoxes

if TYPE_CHECKING:
    from PIL.Image import Image


def draw_sheet(workspace: Workspace, hits: Hits, vocabulary: Vocabulary, limit: int, path: Path) -> Path:
    """Draw the best box of each of the best tracks; return the path.

    Args:
        workspace: Holds the drives.
        hits: At least one, best first.
        vocabulary: Names the classes of the hits.
        limit: How many tracks are drawn at most.
        path: Where the picture goes.
    """
    chosen = best_of_tracks(hits)[0][:limit]
    order = chosen[np.argsort(hits.segment[chosen], kind="stable")]  # a drive is opened once
    tiles = {int(index): _tile(workspace, hits[index : index + 1], vocabulary) for index in order}
    image = sheet([tiles[int(index)] for index in chosen])
    with atomic_file(path) as file:
        image.save(file, format="PNG", compress_level=1)
    return path


def _tile(workspace: Workspace, hit: Hits, vocabulary: Vocabulary) -> Image:
    segment, frame = str(hit.segment[0]), int(hit.frame[0])
    box = TrackedBoxes(
        hit.center_m, hit.size_lwh_m, hit.heading_rad, hit.velocity_mps, hit.score, hit.track_id
    )
    class_name = vocabulary.class_names[hit.class_index[0]]
    title = f"{class_name} {hit.score[0]:.2f}  {segment} frame {frame}  {hit.time_s[0]:.1f} s"
    return tile(_points(workspace, segment, frame), box, _largest_view(workspace, segment, frame, box), title)


def _points(workspace: Workspace, segment: str, frame: int) -> Array:
    with suppress(UpvlError):
        return workspace.drive(segment).points(frame).xyz_ego_m
    return np.zeros((0, 3))


def _largest_view(workspace: Workspace, segment: str, frame: int, box: TrackedBoxes) -> HitPicture | None:
    """Return the picture in which the box is largest; None where no picture shows it."""
    with suppress(UpvlError):
        drive = workspace.drive(segment)
        seen = [(camera, part_with_box(camera, box)) for camera in drive.cameras]
        views = [(camera, part) for camera, part in seen if part is not None]
        for camera, part in sorted(views, key=lambda view: -_area(view[1])):
            image = drive.image(frame, camera.name)
            if image is not None:
                return HitPicture(image.rgb, camera, part)
    return None


def _area(part: tuple[float, float, float, float]) -> float:
    left, top, right, bottom = part
    return (right - left) * (bottom - top)
