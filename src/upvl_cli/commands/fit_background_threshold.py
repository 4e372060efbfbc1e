"""Finds, from unlabelled drives, where on the scale of a model background begins."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from PIL import Image

from upvl_cli.commands.draw import save
from upvl_cli.errors import BadInput
from upvl_cli.perception.background.masks import Background
from upvl_cli.perception.background.threshold import minimum_error
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import mask
from upvl_cli.stages.rows import ExtractVlRow, GroundRow, PcaRow
from upvl_cli.types import Array, Floats

BINS = 200
FRAMES = 20  # of each drive, evenly spread


def calibrate(workspace: Workspace) -> Iterator[str]:
    """Fit the threshold to the points above the ground, draw the histogram; yields what there is to say.

    Raises:
        BadInput: No point has a feature.
        NotMade: A drive has no features yet.
    """
    settings = workspace.settings(mask.STAGE)
    own = workspace.model.background
    against = own.against if settings.calibrated else settings.against
    eps = own.threshold if settings.calibrated else settings.eps_bg
    (fitted,) = workspace.table("pca", PcaRow)
    words = workspace.model.embed_text([*settings.background, *against])
    count = len(settings.background)
    rule = Background(fitted.basis, words[:count], words[count:], eps)
    score = np.concatenate(
        [np.zeros(0), *(_scores(workspace, segment, rule) for segment in workspace.segments)]
    )
    if not len(score):
        raise BadInput("no point above the ground has a feature: calibrate needs drives with cameras")
    counts, edges = np.histogram(score, BINS)
    found = minimum_error(counts, edges)
    path = save(_drawn(counts, edges, found, eps), workspace.out / "calibrate" / "background.png")
    yield f"{len(score)} points above the ground, {workspace.model.name}: background from {found:.3f} on"
    yield f"  {(score >= found).mean():.1%} of them are; from {eps:.3f} on, as now: {(score >= eps).mean():.1%}"
    values = f"calibrated = false, eps_bg = {found:.3f}, against = {_listed(against)}"
    yield f"  to use it, in {workspace.stages / 'mask.toml'}: {values}"
    yield str(path)


def _listed(words: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


def _scores(workspace: Workspace, segment: str, rule: Background) -> Floats:
    """Scores of the points above the ground of some frames of a drive."""
    features = workspace.table("extract-vl", ExtractVlRow, segment)
    ground = workspace.table("ground", GroundRow, segment)
    frames = features.frames
    chosen = (
        sorted({frames[round(place)] for place in np.linspace(0, len(frames) - 1, FRAMES)}) if frames else []
    )
    scores: list[Floats] = [np.zeros(0)]
    for frame in chosen:
        of = features[frame]
        above = ~ground[frame].is_ground[of.state == SEEN]
        scores.append(rule.score(of.feature[above]))
    return np.concatenate(scores)


def _drawn(counts: Array, edges: Array, found: float, eps: float) -> Image.Image:
    from io import BytesIO

    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.stairs(counts, edges, fill=True, color="0.6")
    axes.axvline(found, color="tab:orange", label=f"found: {found:.3f}")
    axes.axvline(eps, color="tab:blue", linestyle="--", label=f"in use: {eps:.3f}")
    axes.set(xlabel="likeness to background words", ylabel="points above the ground")
    axes.legend()
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    return Image.open(buffer)
