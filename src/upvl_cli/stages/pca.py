"""The reduced space of the vision-language features, one for all drives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Needs, Stage
from upvl_cli.stages.picture_rows import PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Drive, Floats


@dataclass(frozen=True)
class PcaConfig(Config):
    """Settings of `pca`."""

    drives: tuple[str, ...] = setting(
        'names of the drives that it is fitted to, with * for anything: "train-*"'
    )
    images: int = setting(
        "number of pictures that it is fitted to, a random sample of those drives; with 0 no feature is stored",
        ge=0,
        le=10**6,
    )
    features_per_image: int = setting(
        "number of features of each picture that it is fitted to, a random sample", ge=64, le=10**6
    )
    seed: int = setting("seed of both random samples", ge=0, le=2**32 - 1)


def run(inputs: Inputs, config: PcaConfig) -> Iterator[PcaRow]:
    """Fit the 64 principal components in which features are stored to a sample of the drives."""
    from functools import partial

    import numpy as np

    from upvl_cli.perception.visual.open_vocabulary import fit
    from upvl_cli.runtime.parallel import in_order

    def embed(drive: Drive, picture: tuple[int, str]) -> Floats:
        """Return (n, d) features of a picture, none where it is missing."""
        image = drive.image(*picture)
        cells = np.zeros((0, 0, 1)) if image is None else inputs.model.embed_image(image.rgb)
        return cells.reshape(-1, cells.shape[-1])

    def features() -> Iterator[Floats]:
        """Yield features of the sampled pictures, in the same order each time."""
        if not config.images:
            return
        pictures = [
            (drive.name, frame.index, camera.name)
            for drive in inputs.drives()
            for frame in drive.frames
            for camera in drive.cameras
        ]
        rng = np.random.default_rng(config.seed)
        chosen = sorted(rng.permutation(len(pictures))[: config.images].tolist())
        for drive in inputs.drives():
            of_drive = [pictures[number][1:] for number in chosen if pictures[number][0] == drive.name]
            for cells in in_order(partial(embed, drive), of_drive):
                inputs.count("pictures", int(len(cells) > 0))
                if len(cells):
                    yield cells[rng.permutation(len(cells))[: config.features_per_image]]

    basis = fit(features(), inputs.model.dim)
    inputs.count("percent of the variance kept", round(100 * basis.variance_kept))
    yield PcaRow(inputs.segment, 0, basis.mean, basis.components.ravel(), basis.scale, basis.variance_kept)


STAGE = Stage(
    name="pca",
    run=run,
    config=PcaConfig,
    row=PcaRow,
    reads=("raw", "vlm"),
    scope="dataset",
    needs=Needs(gpus=1.0, memory_gib=4.0),
)
