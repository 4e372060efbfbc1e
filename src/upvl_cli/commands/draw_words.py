"""Gathers what a picture of words needs from the shards, and draws it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from upvl_cli.commands.draw import VIEW, chosen_frame, save
from upvl_cli.drawing.words import NO_WORD, words_above, words_in_view
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.camera import project
from upvl_cli.perception.visual.pixel_features import at_picture
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import extract_vl
from upvl_cli.stages.rows import ExtractVlRow, FlowRow, OdometryRow, PcaRow


def words_of(text: str) -> list[str]:
    """The words of a text such as "car, tree, person".

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
    """Draw one frame with each point in the colour of its nearest word; yields the files.

    Args:
        workspace: Where.
        segment: Which drive.
        frame: Index of the frame; None takes the middle one.
        words: What to tell apart.

    Raises:
        BadSetting: The drive has no such frame.
        NotMade: It has no features yet.
    """
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    frame = chosen_frame(features, segment, frame)
    (fitted,) = workspace.table("pca", PcaRow)
    drive, of = workspace.drive(segment), features[frame]
    xyz = drive.points(frame).xyz_ego_m
    word = np.full(len(xyz), NO_WORD)
    word[of.state == SEEN] = fitted.basis.cosines(of.feature, workspace.model.embed_text(words)).argmax(
        axis=1
    )
    stem = workspace.out / "draw" / f"{segment}-{frame:06d}-words"
    yield save(words_above(VIEW, xyz, word, words), stem.with_name(f"{stem.name}-above.png"))
    poses = list(workspace.table("odometry", OdometryRow, segment))
    times_ns, world_from_ego = (
        [pose.time_ns for pose in poses],
        np.array([pose.world_from_ego for pose in poses]),
    )
    step = [pose.frame for pose in poses].index(frame)
    follows = workspace.settings(extract_vl.STAGE).follow_motion
    flow_mps = (
        workspace.table("flow", FlowRow, segment)[frame].flow_mps if follows else np.zeros((len(xyz), 3))
    )
    for number, camera in enumerate(drive.cameras):
        image = drive.image(frame, camera.name)
        seen = of.camera == number
        if image is not None:
            then = at_picture(times_ns, world_from_ego, step, xyz[seen], flow_mps[seen], image)
            uv_px = project(camera, then)[0]
            ahead = np.isfinite(uv_px).all(axis=1)
            picture = words_in_view(image.rgb, uv_px[ahead], word[seen][ahead], words)
            yield save(picture, stem.with_name(f"{stem.name}-{camera.name}.png"))
