"""The datasets that `stages/raw.toml` can name. Each loads its adapter only when it is opened.

Another package adds one by an entry point in the group `upvl.datasets`, whose object is a `DatasetFamily`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.config.base import Config
from upvl_cli.errors import BadSetting, one_line
from upvl_cli.synthetic.config import CityConfig

if TYPE_CHECKING:
    from upvl_cli.types import Dataset

GROUP = "upvl.datasets"


@dataclass(frozen=True)
class DatasetFamily:
    """How one kind of dataset is opened.

    Attributes:
        open: From the folder that `raw.toml` names, and the settings of its own.
        config: Settings of its own, in `stages/<name>.toml`; None where the folder is all it needs.
    """

    open: Callable[[Path, Any], Dataset]
    config: type[Config] | None = None


def _argoverse2(root: Path, config: None) -> Dataset:
    from upvl_cli.datasets.argoverse2.dataset import Argoverse2

    return Argoverse2(root)


def _kitti(root: Path, config: None) -> Dataset:
    from upvl_cli.datasets.kitti.dataset import Kitti

    return Kitti(root)


def _nuscenes(root: Path, config: None) -> Dataset:
    from upvl_cli.datasets.nuscenes.dataset import NuScenes

    return NuScenes(root)


def _parquet(root: Path, config: None) -> Dataset:
    from upvl_cli.datasets.parquet.dataset import ParquetDrives

    return ParquetDrives(root)


def _py123d(root: Path, config: None) -> Dataset:
    try:
        from upvl_cli.datasets.py123d.dataset import Py123dLogs
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise BadSetting(
            f"the dataset py123d needs the package {package}; run: pip install 'upvl[py123d]'"
        ) from None
    except ImportError as error:  # another version of the library, or a system library that OpenCV lacks
        raise BadSetting(
            f"the package py123d cannot be loaded: {one_line(error)}; run: pip install 'upvl[py123d]'"
        ) from None
    return Py123dLogs(root)


def _synthetic(root: Path, config: CityConfig) -> Dataset:
    try:
        from upvl_cli.synthetic.dataset import City
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise BadSetting(
            f"the dataset synthetic needs the package {package}; run: pip install 'upvl[synthetic]', "
            "or name drives of your own in stages/raw.toml"
        ) from None
    return City(config)


def _waymo(root: Path, config: None) -> Dataset:
    from upvl_cli.datasets.waymo.dataset import Waymo

    return Waymo(root)


DATASETS: dict[str, DatasetFamily] = {
    "argoverse2": DatasetFamily(_argoverse2),
    "kitti": DatasetFamily(_kitti),
    "nuscenes": DatasetFamily(_nuscenes),
    "parquet": DatasetFamily(_parquet),
    "py123d": DatasetFamily(_py123d),
    "synthetic": DatasetFamily(_synthetic, CityConfig),
    "waymo": DatasetFamily(_waymo),
}


def dataset_family(name: str) -> DatasetFamily:
    """Return the dataset of a name: one of ours, or one that an installed package adds.

    Raises:
        BadSetting: No dataset has that name, or the package that adds it cannot be loaded.
    """
    if name in DATASETS:
        return DATASETS[name]
    from importlib.metadata import entry_points  # slow to import, and seldom needed

    added = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name in added:
        return _loaded(name, added[name].load)
    known = sorted({*DATASETS, *added})
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise BadSetting(f"raw.toml: unknown dataset {name!r}{hint} (known: {', '.join(known)})")


def _loaded(name: str, load: Callable[[], Any]) -> DatasetFamily:
    try:
        found = load()
    except (ImportError, AttributeError) as error:
        raise BadSetting(
            f"raw.toml: the package that adds dataset {name!r} cannot be loaded: {one_line(error)}"
        ) from error
    if not isinstance(found, DatasetFamily):
        raise BadSetting(f"raw.toml: dataset {name!r} is a {type(found).__name__}, expected a DatasetFamily")
    return found
