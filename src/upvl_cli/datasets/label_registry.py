"""The human (or exact) labels of each dataset. Only evaluation may import this: no stage can reach a label.

Another package adds labels by entry points in the groups `upvl.labels` and `upvl.true_flow`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from upvl_cli.datasets.labels import LabelSource
from upvl_cli.errors import BadInput, BadSetting, one_line

if TYPE_CHECKING:
    from upvl_cli.datasets.flow_truth import FlowTruth


class FlowSource(Protocol):
    """True motion of LiDAR points."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """Return the motion of each point of a sweep, in the order of its points."""


def _argoverse2(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.argoverse2.labels import ArgoverseLabels

    return ArgoverseLabels(dataset)


def _kitti(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.kitti.labels import KittiLabels

    return KittiLabels(root)


def _nuscenes(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.nuscenes.labels import NuScenesLabels

    return NuScenesLabels(dataset)


def _parquet(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.parquet.labels import ParquetLabels

    return ParquetLabels(root, dataset)


def _py123d(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.py123d.labels import Py123dLabels

    return Py123dLabels(root, dataset)


def _city(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.synthetic.labels import CityLabels

    return CityLabels(dataset)


def _waymo(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.waymo.labels import WaymoLabels

    return WaymoLabels(root)


def _city_flow(root: Path, dataset: Any) -> FlowSource:
    from upvl_cli.synthetic.labels import CityFlow

    return CityFlow(dataset)


# Each takes the folder that raw.toml names and the opened dataset.
LABELS: dict[str, Callable[[Path, Any], LabelSource]] = {
    "argoverse2": _argoverse2,
    "kitti": _kitti,
    "nuscenes": _nuscenes,
    "parquet": _parquet,
    "py123d": _py123d,
    "synthetic": _city,
    "waymo": _waymo,
}
TRUE_FLOW: dict[str, Callable[[Path, Any], FlowSource]] = {"synthetic": _city_flow}


def label_source(name: str, root: Path, dataset: Any) -> LabelSource:
    """Return the labels of a dataset.

    Raises:
        BadInput: The dataset has no adapter for labels.
        BadSetting: The package that adds the labels cannot be loaded.
    """
    opener = LABELS.get(name) or _added("upvl.labels", name)
    if opener is None:
        raise BadInput(
            f"dataset {name!r} has no labels that upvl can read: there is nothing to score against"
        )
    source: LabelSource = opener(root, dataset)
    return source


def flow_source(name: str, root: Path, dataset: Any) -> FlowSource | None:
    """Return the true flow of a dataset; None where nobody knows it.

    Raises:
        BadSetting: The package that adds the flow cannot be loaded.
    """
    opener = TRUE_FLOW.get(name) or _added("upvl.true_flow", name)
    return opener(root, dataset) if opener else None


def _added(group: str, name: str) -> Callable[[Path, Any], Any] | None:
    """Return what an installed package adds under a name."""
    from importlib.metadata import entry_points  # slow to import, and seldom needed

    entry = next((entry for entry in entry_points(group=group) if entry.name == name), None)
    if entry is None:
        return None
    what = group.rpartition(".")[2].replace("_", " ")
    try:
        opener = entry.load()
    except (ImportError, AttributeError) as error:
        raise BadSetting(
            f"the package that adds {what} of dataset {name!r} cannot be loaded: {one_line(error)}"
        ) from error
    if not callable(opener):
        raise BadSetting(f"the {what} of dataset {name!r} are a {type(opener).__name__}, expected a function")
    return cast("Callable[[Path, Any], Any]", opener)
