"""The datasets that `stages/raw.toml` can name. Each loads its adapter only when it is opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.datasets.city.settings import CityParams

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Dataset


def _kitti(root: Path, settings: Any) -> Dataset:
    from upvl_cli.datasets.kitti import Kitti

    return Kitti(root)


def _street(root: Path, settings: Any) -> Dataset:
    from upvl_cli.datasets.street import Streets

    return Streets()


def _city(root: Path, settings: Any) -> Dataset:
    from upvl_cli.datasets.city.dataset import City

    return City(settings)


# Of the folder that raw.toml names, and of the settings of the dataset's own, where it has some.
DATASETS: dict[str, Callable[[Path, Any], Dataset]] = {"kitti": _kitti, "street": _street, "synthetic": _city}
SETTINGS: dict[str, type] = {"synthetic": CityParams}
