"""The basis that features are kept in, one for all drives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.algorithms.open_vocabulary import Basis
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array, Floats


@dataclass(frozen=True)
class PcaParams:
    """Settings of `pca`."""

    drives: tuple[str, ...] = param('names of the drives to fit it to, with * for anything: "train-*"')
    images: int = param(
        "pictures to fit it to, spread over those drives; 0 where no picture is used", least=0, most=10**6
    )
    cells: int = param("features of each picture that it is fitted to", least=64, most=10**6)


@dataclass(frozen=True)
class PcaRow(Row):
    """The basis; one row for all drives. `components` holds 64 rows, one after the other."""

    mean: Array = column("float32", "mean of the features, all of length 1", per="dimension")
    components: Array = column("float32", "principal axes, those of the most variance first", per="value")
    scale: Array = column("float32", "size of a step of each rounded value", per="component")
    variance_kept: float = column("float64", "share of the variance that is kept")

    @property
    def basis(self) -> Basis:
        """The basis itself."""
        from upvl_cli.algorithms.open_vocabulary import Basis

        return Basis(self.mean, self.components.reshape(-1, len(self.mean)), self.scale, self.variance_kept)


def run(inputs: Inputs, params: PcaParams) -> Iterator[PcaRow]:
    """Fit the 64 values that are kept of a feature to a sample of the drives."""
    from functools import partial

    import numpy as np

    from upvl_cli.algorithms.open_vocabulary import fit
    from upvl_cli.parallel import in_order

    def embedded(drive: Any, picture: tuple[int, str]) -> Floats:
        """(n, d) features of a picture, none where it is missing."""
        image = drive.image(*picture)
        cells = np.zeros((0, 0, 1)) if image is None else inputs.model.embed_image(image.rgb)
        return cells.reshape(-1, cells.shape[-1])

    def features() -> Iterator[Floats]:
        """Some cells of some pictures, in the same order each time."""
        if not params.images:
            return
        pictures = [
            (drive.name, frame.index, camera.name)
            for drive in inputs.drives()
            for frame in drive.frames
            for camera in drive.cameras
        ]
        rng = np.random.default_rng(0)
        chosen = sorted(rng.permutation(len(pictures))[: params.images].tolist())
        for drive in inputs.drives():
            own = [pictures[place][1:] for place in chosen if pictures[place][0] == drive.name]
            for cells in in_order(partial(embedded, drive), own):
                inputs.count("pictures", int(len(cells) > 0))
                if len(cells):
                    yield cells[rng.permutation(len(cells))[: params.cells]]

    basis = fit(features(), inputs.model.dim)
    inputs.count("percent of the variance kept", round(100 * basis.variance_kept))
    yield PcaRow(inputs.segment, 0, basis.mean, basis.components.ravel(), basis.scale, basis.variance_kept)


STAGE = Stage(name="pca", run=run, params=PcaParams, row=PcaRow, reads=("raw", "vlm"), whole=True)
