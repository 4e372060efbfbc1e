"""The datasets that `stages/raw.toml` can name. Each loads its adapter only when it is opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Dataset


def _kitti(root: Path) -> Dataset:
    from upvl_cli.datasets.kitti import Kitti

    return Kitti(root)


def _synthetic(root: Path) -> Dataset:
    from upvl_cli.datasets.synthetic import Synthetic

    return Synthetic()


DATASETS: dict[str, Callable[[Path], Dataset]] = {"kitti": _kitti, "synthetic": _synthetic}
