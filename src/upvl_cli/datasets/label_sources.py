"""The human (or exact) labels of each dataset. Only evaluation may import this: no stage can reach a label."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from upvl_cli.datasets.base import LabelSource

if TYPE_CHECKING:
    from upvl_cli.datasets.flow_truth import FlowTruth


class FlowSource(Protocol):
    """True motion of LiDAR points."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """The motion of each point of a sweep, in the order of its points."""


def _kitti(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.kitti_labels import KittiLabels

    return KittiLabels(root)


def _street(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.street_labels import StreetLabels

    return StreetLabels()


def _street_flow(dataset: Any) -> FlowSource:
    from upvl_cli.datasets.street_truth import StreetFlow

    return StreetFlow()


def _city(root: Path, dataset: Any) -> LabelSource:
    from upvl_cli.datasets.city_labels import CityLabels

    return CityLabels(dataset)


def _city_flow(dataset: Any) -> FlowSource:
    from upvl_cli.datasets.city_labels import CityFlow

    return CityFlow(dataset)


# Of the folder that raw.toml names and the opened dataset.
LABELS: dict[str, Callable[[Path, Any], LabelSource]] = {
    "kitti": _kitti,
    "street": _street,
    "synthetic": _city,
}
TRUE_FLOW: dict[str, Callable[[Any], FlowSource]] = {"street": _street_flow, "synthetic": _city_flow}
