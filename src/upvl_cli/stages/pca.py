"""The basis that features are kept in, one for all drives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Floats


@dataclass(frozen=True)
class PcaConfig(Config):
    """Settings of `pca`."""

    drives: tuple[str, ...] = setting('names of the drives to fit it to, with * for anything: "train-*"')
    images: int = setting(
        "pictures to fit it to, spread over those drives; 0 where no picture is used", ge=0, le=10**6
    )
    cells: int = setting("features of each picture that it is fitted to", ge=64, le=10**6)


def run(inputs: Inputs, config: PcaConfig) -> Iterator[PcaRow]:
    """Fit the 64 values that are kept of a feature to a sample of the drives."""
    from functools import partial

    import numpy as np

    from upvl_cli.perception.visual.open_vocabulary import fit
    from upvl_cli.runtime.parallel import in_order

    def embedded(drive: Any, picture: tuple[int, str]) -> Floats:
        """(n, d) features of a picture, none where it is missing."""
        image = drive.image(*picture)
        cells = np.zeros((0, 0, 1)) if image is None else inputs.model.embed_image(image.rgb)
        return cells.reshape(-1, cells.shape[-1])

    def features() -> Iterator[Floats]:
        """Some cells of some pictures, in the same order each time."""
        if not config.images:
            return
        pictures = [
            (drive.name, frame.index, camera.name)
            for drive in inputs.drives()
            for frame in drive.frames
            for camera in drive.cameras
        ]
        rng = np.random.default_rng(0)
        chosen = sorted(rng.permutation(len(pictures))[: config.images].tolist())
        for drive in inputs.drives():
            own = [pictures[place][1:] for place in chosen if pictures[place][0] == drive.name]
            for cells in in_order(partial(embedded, drive), own):
                inputs.count("pictures", int(len(cells) > 0))
                if len(cells):
                    yield cells[rng.permutation(len(cells))[: config.cells]]

    basis = fit(features(), inputs.model.dim)
    inputs.count("percent of the variance kept", round(100 * basis.variance_kept))
    yield PcaRow(inputs.segment, 0, basis.mean, basis.components.ravel(), basis.scale, basis.variance_kept)


STAGE = Stage(name="pca", run=run, config=PcaConfig, row=PcaRow, reads=("raw", "vlm"), scope="dataset")
