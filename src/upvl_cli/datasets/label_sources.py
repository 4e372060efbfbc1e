"""The human (or exact) labels of each dataset. Only evaluation may import this: no stage can reach a label."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from upvl_cli.datasets.base import LabelSource

if TYPE_CHECKING:
    from upvl_cli.datasets.synthetic_truth import FlowTruth


class FlowSource(Protocol):
    """True motion of LiDAR points."""

    def flow(self, segment: str, frame: int) -> FlowTruth:
        """The motion of each point of a sweep, in the order of its points."""


def _kitti(root: Path) -> LabelSource:
    from upvl_cli.datasets.kitti_labels import KittiLabels

    return KittiLabels(root)


def _synthetic(root: Path) -> LabelSource:
    from upvl_cli.datasets.synthetic_labels import SyntheticLabels

    return SyntheticLabels()


def _synthetic_flow(root: Path) -> FlowSource:
    from upvl_cli.datasets.synthetic_truth import SyntheticFlow

    return SyntheticFlow()


LABELS: dict[str, Callable[[Path], LabelSource]] = {"kitti": _kitti, "synthetic": _synthetic}
TRUE_FLOW: dict[str, Callable[[Path], FlowSource]] = {"synthetic": _synthetic_flow}
