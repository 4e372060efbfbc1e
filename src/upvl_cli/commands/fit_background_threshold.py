"""Fit the threshold from which points are background, on the scale of a model, to unlabelled drives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from PIL import Image

from upvl_cli.commands.draw import save
from upvl_cli.config.base import Config, setting
from upvl_cli.config.toml import load
from upvl_cli.errors import BadInput
from upvl_cli.perception.background.masks import BackgroundClassifier
from upvl_cli.perception.background.threshold import minimum_error_threshold
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import mask
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import GroundRow
from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class ThresholdFitConfig(Config):
    """Settings of `fit-background-threshold`."""

    frames_per_drive: int = setting(
        "frames of each drive whose scores are counted, evenly spread", ge=1, le=10**6
    )
    bins: int = setting("bins of the histogram of scores", ge=2, le=10**5)


def fit_background_threshold(workspace: Workspace) -> Iterator[str]:
    """Fit the threshold to the points above the ground, draw the histogram, and yield lines for people.

    Raises:
        BadInput: No point has a feature.
        NotMade: A drive has no features yet.
    """
    config = load(ThresholdFitConfig, workspace.stages / "fit-background-threshold.toml")
    (pca,) = workspace.table("pca", PcaRow)
    settings = workspace.settings(mask.STAGE)
    classifier = mask.background_classifier(pca, workspace.model, settings)
    score = np.concatenate(
        [
            np.zeros(0),
            *(
                scores_above_ground(workspace, segment, classifier, config.frames_per_drive)
                for segment in workspace.segments
            ),
        ]
    )
    if not len(score):
        raise BadInput(
            "no point above the ground has a feature: the fit of a threshold needs drives with cameras"
        )
    counts, edges = np.histogram(score, config.bins)
    fitted, current = minimum_error_threshold(counts, edges), classifier.threshold
    path = save(
        _draw_histogram(counts, edges, fitted, current),
        workspace.out / "fit-background-threshold" / "background.png",
    )
    yield f"{len(score)} points above the ground, {workspace.model.name}: background from {fitted:.3f} on"
    share, current_share = (score >= fitted).mean(), (score >= current).mean()
    yield f"  {share:.1%} of them are; from {current:.3f} on, as now: {current_share:.1%}"
    against = workspace.model.background.against if settings.use_model_rule else settings.against
    values = f"use_model_rule = false, eps_bg = {fitted:.3f}, against = {_toml_list(against)}"
    yield f"  to use it, in {workspace.stages / 'mask.toml'}: {values}"
    yield str(path)


def _toml_list(words: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


def scores_above_ground(
    workspace: Workspace, segment: str, classifier: BackgroundClassifier, frames: int
) -> Floats:
    """Return (n,) background scores of the points above the ground, in frames spread evenly over a drive.

    Args:
        workspace: Holds the features and the ground.
        segment: Name of the drive.
        classifier: Gives the scores.
        frames: Number of frames, at most.
    """
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    grounds = workspace.table("ground", GroundRow, segment)
    all_frames = features.frames
    steps = np.linspace(0, len(all_frames) - 1, frames) if all_frames else np.zeros(0)
    scores: list[Floats] = [np.zeros(0)]
    for frame in sorted({all_frames[round(step)] for step in steps}):
        row = features[frame]
        above = ~grounds[frame].is_ground[row.state == SEEN]
        scores.append(classifier.score(row.feature[above]))
    return np.concatenate(scores)


def _draw_histogram(counts: Array, edges: Array, fitted: float, current: float) -> Image.Image:
    from io import BytesIO

    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.stairs(counts, edges, fill=True, color="0.6")
    axes.axvline(fitted, color="tab:orange", label=f"fitted: {fitted:.3f}")
    axes.axvline(current, color="tab:blue", linestyle="--", label=f"in use: {current:.3f}")
    axes.set(xlabel="similarity to background words", ylabel="points above the ground")
    axes.legend()
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    return Image.open(buffer)
