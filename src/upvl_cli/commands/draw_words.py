"""Draw each point of a frame in the colour of its nearest word, or of its class, from the shards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from upvl_cli.commands.draw import VIEW, chosen_frame, save
from upvl_cli.drawing.words import NO_WORD, words_above, words_in_view
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.camera import project
from upvl_cli.perception.visual.pixel_features import move_to_image_time
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import extract_vl
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow, SemanticsRow
from upvl_cli.stages.rows import FlowRow, OdometryRow
from upvl_cli.types import Ints


def split_words(text: str) -> list[str]:
    """Return the words of a text such as "car, tree, person".

    Raises:
        BadSetting: There is none.
    """
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words:
        raise BadSetting(
            f'--words {text!r} has no word; expected words between commas: --words "car, tree, person"'
        )
    return words


def draw_words(workspace: Workspace, segment: str, frame: int | None, words: Sequence[str]) -> Iterator[Path]:
    """Draw one frame with each point in the color of its nearest word; yields the files.

    Args:
        workspace: Holds the features; the files are written into its `out/draw`.
        segment: Name of the drive.
        frame: Index of the frame; None takes the middle one.
        words: Words or phrases that the points are classified by.

    Raises:
        BadSetting: The drive has no such frame.
        NotMade: It has no features yet.
    """
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    frame = chosen_frame(features, segment, frame)
    (pca,) = workspace.table("pca", PcaRow)
    row = features[frame]
    word = np.full(len(row.state), NO_WORD)
    cosines = pca.basis.cosines(row.feature, workspace.model.embed_text(words))
    word[row.state == SEEN] = cosines.argmax(axis=1)
    yield from _draw_points(workspace, segment, row, word, words, "words")


def draw_semantics(workspace: Workspace, segment: str, frame: int | None) -> Iterator[Path]:
    """Draw one frame with each point in the colour of its class, as `semantics` fused it; yields the files.

    Args:
        workspace: Holds the classes; the files are written into its `out/draw`.
        segment: Name of the drive.
        frame: Index of the frame; None takes the middle one.

    Raises:
        BadSetting: The drive has no such frame.
        NotMade: It has no classes yet.
    """
    classes = workspace.table("semantics", SemanticsRow, segment)
    frame = chosen_frame(classes, segment, frame)
    row = classes[frame]
    seen = workspace.table("extract-vl", ExtractVlRow, segment)[frame]
    yield from _draw_points(workspace, segment, seen, row.class_index, row.class_name.tolist(), "semantics")


def _draw_points(
    workspace: Workspace, segment: str, row: ExtractVlRow, word: Ints, words: Sequence[str], suffix: str
) -> Iterator[Path]:
    """Draw the points of a frame from above, and those that a camera sees on its picture.

    Args:
        workspace: Holds the drive, its poses and its flow.
        segment: Name of the drive.
        row: Which camera sees each point of the frame.
        word: (n,) place in `words` of each point, `NO_WORD` for none.
        words: The words.
        suffix: Part of the names of the files.
    """
    drive, frame = workspace.drive(segment), row.frame
    xyz = drive.points(frame).xyz_ego_m
    stem = workspace.out / "draw" / f"{segment}-{frame:06d}-{suffix}"
    yield save(words_above(VIEW, xyz, word, words), stem.with_name(f"{stem.name}-above.png"))
    poses = list(workspace.table("odometry", OdometryRow, segment))
    times_ns = [pose.time_ns for pose in poses]
    world_from_ego = np.array([pose.world_from_ego for pose in poses])
    step = [pose.frame for pose in poses].index(frame)
    follows = workspace.settings(extract_vl.STAGE).follow_motion
    flow_mps = (
        workspace.table("flow", FlowRow, segment)[frame].flow_mps if follows else np.zeros((len(xyz), 3))
    )
    for number, camera in enumerate(drive.cameras):
        image = drive.image(frame, camera.name)
        seen = row.camera == number
        if image is not None:
            moved = move_to_image_time(times_ns, world_from_ego, step, xyz[seen], flow_mps[seen], image)
            uv_px = project(camera, moved)[0]
            ahead = np.isfinite(uv_px).all(axis=1)
            picture = words_in_view(image.rgb, uv_px[ahead], word[seen][ahead], words)
            yield save(picture, stem.with_name(f"{stem.name}-{camera.name}.png"))
